"""`covey bench start`, `memory` and `live`: real processes over loopback, from `covey up` to the first tick and on."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from deploy.bench.timing import Row
from deploy.swarm.processes import ROOT

PAGE_TOTAL = "Pss:"
START_SECONDS = 120.0
TEAMS = {16: "A4,B12", 48: "5", 96: "A12,C48,D36"}


def run(agents: int, spawn: str, seconds: float, interest: str = "all") -> Row:
    """One lockstep run of a swarm of processes: s from `covey up` to the first tick, PSS in MB, CPU s of the agents, ticks per s."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["up", "efficacy", "--team", TEAMS[agents], "--lockstep", "--seconds", str(seconds), "--run", "bench", "--json"]
        words += ["--spawn", spawn, "--set", f"timing.interest={interest}"]
        environment = {**os.environ, "COVEY_RUNS": folder}
        command = [sys.executable, "-m", "deploy", *words]
        begun = time.monotonic()
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        try:
            log = Path(folder) / "bench" / "logs" / "supervisor.jsonl"
            first = _first_tick(log, process, begun)
            time.sleep(min(2.0, seconds / 4.0))
            pids = _pids(log.parent.parent)
            memory, cpu, at = sum(map(pss, pids)), sum(map(cpu_of, pids)), time.monotonic()
            time.sleep(1.0)
            spent, wall = sum(map(cpu_of, pids)) - cpu, time.monotonic() - at
            output, _ = process.communicate(timeout=600.0)
        finally:
            process.kill()
            process.wait()
        result = json.loads(output.splitlines()[-1])
    return {
        "agents": agents,
        "spawn": spawn,
        "interest": interest,
        "first tick, s": first,
        "PSS, MB": memory / 1024.0,
        "ticks per s": result["ticks"] / result["wall_s"],
        "CPU of agents, cores": spent / wall if spent >= 0.0 else float("nan"),
        "load": os.getloadavg()[0],
    }


def _first_tick(log: Path, process: "subprocess.Popen[bytes]", begun: float) -> float:
    while time.monotonic() - begun < START_SECONDS and process.poll() is None:
        if log.exists() and "the first tick" in log.read_text(encoding="utf-8"):
            return time.monotonic() - begun
        time.sleep(0.02)
    raise RuntimeError(f"no tick within {START_SECONDS:g} s")


def _pids(folder: Path) -> list[int]:
    """Process ids of the agents of a run."""
    from deploy.swarm.control import ControlClient
    from deploy.swarm.rundir import RunDirectory

    os.environ["COVEY_RUNS"] = str(folder.parent)
    data: dict[str, Any] = ControlClient(RunDirectory(folder.name)).ask("status")["data"]
    return [row["pid"] for row in data["processes"] if row["pid"] and row["name"] != "world"]


def pss(pid: int) -> int:
    """Proportional set size of a process, kB; 0 when it has gone."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith(PAGE_TOTAL))


def cpu_of(pid: int) -> float:
    """CPU time of a process so far, s; 0 when it has gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
