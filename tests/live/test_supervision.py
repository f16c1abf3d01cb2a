"""Real processes: none survives its supervisor, and bad input is one clear line with exit code 2."""

import contextlib
import os
import socket
from pathlib import Path

import pytest

from tests.live.harness import Covey, rows

pytestmark = pytest.mark.live
LONG = ("quick", "--seconds", "100000", "--set", "run.rate=4")


@pytest.mark.slow
def test_no_process_survives_a_killed_supervisor_not_even_a_paused_one(covey: Covey) -> None:
    supervisor = covey.start("up", *LONG)
    covey.running()
    assert covey.run("pause", "s2")[0] == 0
    assert len(covey.processes()) == 9  # six agents, the world, the zygote, the supervisor
    supervisor.kill()
    covey.wait_until_gone()


@pytest.mark.slow
def test_a_reader_who_stops_reading_holds_up_neither_the_run_nor_an_order(covey: Covey) -> None:
    """As under a held terminal or a stopped pager: the pipe of the supervisor's output is full from the start."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(writing, bytes(4096)):
            pass
    os.set_blocking(writing, True)
    supervisor = covey.start("up", *LONG, limit=lambda: [os.dup2(writing, number) for number in (1, 2)] and None)
    os.close(writing)
    covey.wait(lambda data: data["swarm"]["tick"] > 100)  # a line every 5 s, and a round every 1/16 s
    assert covey.run("kill", "s2")[:2] == (0, "killed s2\n")
    assert covey.run("down")[0] == 0
    with os.fdopen(reading, "rb") as pipe:  # the result of the run waits for a reader
        assert b"rounds" in pipe.read().rpartition(b"\0")[2]
    assert supervisor.wait(20.0) == 0
    covey.wait_until_gone()


@pytest.mark.slow
def test_a_detached_run_is_acted_on_from_elsewhere_and_a_second_one_of_its_name_is_refused(covey: Covey) -> None:
    code, output, complaints = covey.run("up", *LONG, "--detach", "--run", "mine")
    assert (code, complaints) == (0, "")
    assert "run mine is up" in output
    covey.running()

    code, _, complaints = covey.run("up", *LONG, "--run", "mine")
    assert code == 2
    assert complaints.startswith("covey: --run mine: a run of this name is running")
    assert complaints.count("\n") == 1

    assert covey.run("kill", "s2,s3")[1] == "killed s2, s3\n"
    dead = rows(
        covey.wait(lambda data: all(rows(data)[name]["state"] == "dead" and not rows(data)[name]["alive"] for name in ("s2", "s3")))
    )
    assert dead["s3"]["end"] == "killed by SIGKILL"
    assert "dead: killed by SIGKILL" in covey.run("ps")[1]
    assert covey.run("kill", "s3") == (2, "", "covey: s3 is not running; `covey restart s3` brings it back\n")
    code, _, complaints = covey.run("kill", "s99")
    assert code == 2 and "'s99': there is no such process; known are s1, s2" in complaints

    assert covey.run("restart")[1] == "restarted s2, s3\n"
    back = rows(covey.wait(lambda data: rows(data)["s3"].get("tick", -1) > dead["s3"]["tick"]))
    assert (back["s3"]["state"], back["s3"]["incarnation"]) == ("running", 2)
    assert covey.run("restart", "s3")[1] == "restarted s3\n", "a living one too"
    covey.wait(lambda data: rows(data)["s3"]["alive"] and rows(data)["s3"]["incarnation"] == 3)

    assert covey.run("pause", "s1")[1] == "paused s1\n"
    assert rows(covey.wait(lambda data: not rows(data)["s1"]["alive"]))["s1"]["state"] == "paused"
    assert covey.run("resume")[1] == "resumed s1\n"
    covey.wait(lambda data: rows(data)["s1"]["alive"])

    assert covey.run("down", "--run", "mine")[:2] == (0, "run mine is down\n")
    covey.wait_until_gone()
    assert covey.run("ps")[0] == 2
    assert (covey.folder / "runs" / "mine" / "result.json").is_file()


@pytest.mark.slow
def test_a_killed_world_stops_the_clock_and_a_restarted_one_goes_on_where_it_stopped(covey: Covey) -> None:
    covey.start("up", *LONG)
    covey.running()
    assert covey.run("kill", "world")[1] == "killed world\n"
    stopped = covey.wait(lambda data: rows(data)["world"]["state"] == "dead")
    assert covey.run("restart", "world")[0] == 0
    agents = [f"s{number}" for number in range(1, 7)]
    later = covey.wait(
        lambda data: data["swarm"]["tick"] > stopped["swarm"]["tick"] + 10 and all(rows(data)[name]["alive"] for name in agents)
    )
    assert rows(later)["world"]["incarnation"] == 2
    assert covey.run("down")[0] == 0
    covey.wait_until_gone()


WRONG = [
    (("up", "nowhere"), "scenario 'nowhere' does not exist; known are anisotropic, convergence"),
    (("up", "missing.toml"), "missing.toml: there is no such file"),
    (("up", "bad.toml"), "bad.toml: arena.widht: there is no such field; did you mean width?"),
    (("up", "quick", "--set", "sensors.X.radius=-3", "--set", "sensors.X.angle=90", "--team", "2X"), "sensors.X.radius = -3"),
    (("up", "quick", "--team", "2Q"), "sensor class 'Q' does not exist; known are A"),
    (("up", "quick", "--dt", "-1"), "run.dt = -1.0"),
    (("up", "quick", "--kill", "s77@1"), "s77"),
    (("up", "quick", "--set", "network.listen=['tcp/0.0.0.0:0']"), "network.listen = 'tcp/0.0.0.0:0': leaves this machine without TLS"),
    (("up", "quick", "--nonsense"), "--nonsense"),
    (("nonsense",), "nonsense"),
    (("up", "twin.toml"), "members.world: this name belongs to the world"),
    (("up", "quick", "--seed", "one"), "seed"),
    (("watch", "--run", "nobody"), "--run nobody: no run of this name is running"),
]


@pytest.mark.parametrize(("words", "complaint"), [*WRONG[:6], *(pytest.param(*wrong, marks=pytest.mark.slow) for wrong in WRONG[6:])])
def test_bad_input_is_one_line_that_says_what_would_be_right(covey: Covey, words: tuple[str, ...], complaint: str) -> None:
    (covey.folder / "bad.toml").write_text("[arena]\nwidht = 3.0\n")
    (covey.folder / "twin.toml").write_text('[members]\nworld = "A"\n')
    code, output, complaints = covey.run(*words)
    assert code == 2
    assert complaint in complaints
    assert complaints.startswith("covey: ") and complaints.count("\n") == 1
    assert "Traceback" not in complaints + output


def test_a_port_in_use_is_one_line_and_nobody_stays_behind(covey: Covey) -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        endpoint = f"tcp/127.0.0.1:{holder.getsockname()[1]}"
        code, _, complaints = covey.run("up", "quick", "--set", f"network.listen=['{endpoint}']")
    assert code == 2
    assert complaints == f"covey: network.listen = {endpoint}: the port is in use; choose a free one, or port 0 for any\n"


@pytest.mark.slow
def test_a_process_that_refuses_its_settings_ends_the_run_with_its_own_words(covey: Covey) -> None:
    """A motion that only the process of the world cannot make: the command has found nothing wrong with it."""
    lines = [
        "import sys",
        "class Motion:",
        "    def __init__(self, settings, dt, seed):",
        "        if sys.modules['__main__'].__spec__.name.startswith('world'):",
        "            raise ValueError('no map of this town')",
        "    def move(self, positions, headings, ids, tick):",
        "        return positions, headings",
    ]
    (covey.folder / "towns.py").write_text("\n".join(lines) + "\n")
    code, _, complaints = covey.run("up", "quick", "--set", "targets.motion=towns:Motion")
    assert code == 2
    assert complaints.startswith(
        "covey: world: targets.motion = 'towns:Motion': towns:Motion raised ValueError: no map of this town (towns.py, line 5)"
    )
    assert complaints.count("\n") == 1


def test_check_says_what_the_scenario_comes_to_and_opens_a_session(covey: Covey) -> None:
    code, output, _ = covey.run("check", "quick")
    assert code == 0
    assert "6 agents (2 A, 4 B)" in output
    assert "session opens on 127.0.0.1" in output


def test_an_agent_process_by_hand_refuses_an_unknown_name_and_a_missing_file(covey: Covey) -> None:
    import subprocess
    import sys

    root = Path(__file__).parents[2]
    (covey.folder / "run.toml").write_text('[members]\ns1 = "A"\n')
    for words, complaint in [
        (
            ("--name", "s9", "--config", "run.toml"),
            "agents: --name s9: the roster has no such member; it has s1. --sensor CLASS says which sensor it carries",
        ),
        (("--name", "s1", "--config", "nowhere.toml"), "agents: nowhere.toml: there is no such file"),
    ]:
        done = subprocess.run(
            [sys.executable, "-P", "-m", "agents", *words],
            cwd=covey.folder,
            env={**os.environ, "PYTHONPATH": str(root)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert (done.returncode, done.stderr) == (2, complaint + "\n")
