"""The commands of docs/how-to/many-machines.md, typed on three machines: network namespaces on one switch, with the addresses of the page.

10.0.0.1  s1 and its body --- switch --- 10.0.0.2  s2 and its body
                                |
                            10.0.0.3  who watches, with the keys of the monitor
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.recording.recording import Recording, event_of
from protocol.geometry import polygon_area
from protocol.node import messages_of
from protocol.observer_messages import Estimate
from tests.docs import Block, blocks_of
from tests.live.harness import ROOT
from tests.live.test_namespaces import WHY_NOT, ip

pytestmark = [
    pytest.mark.live,
    pytest.mark.namespaces,
    pytest.mark.slow,
    pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT),
    pytest.mark.timeout(200),
]
PAGE = "docs/how-to/many-machines.md"
LAPTOPS = ("10.0.0.1", "10.0.0.2", "10.0.0.3")
RECORDED = 10.0  # s, with the start of the command
NEEDED = {"10.0.0.1": "s1", "10.0.0.2": "s2", "10.0.0.3": "monitor"}  # whose keys a machine has


class Laptops:
    """The machines, each with a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.switch = f"covey-{os.getpid()}-switch"
        self.spaces = {address: f"covey-{os.getpid()}-{address[-1]}" for address in LAPTOPS}
        self.processes: list[subprocess.Popen[str]] = []
        self.blocks = [block for block in blocks_of(PAGE) if block.language in ("sh", "toml")]

    def build(self) -> None:
        ip("netns", "add", self.switch)
        ip("-n", self.switch, "link", "add", "lan", "type", "bridge")
        ip("-n", self.switch, "link", "set", "lan", "up")
        for address, space in self.spaces.items():
            port = f"port{address[-1]}"
            ip("netns", "add", space)
            ip("link", "add", "lan0", "netns", space, "type", "veth", "peer", "name", port, "netns", self.switch)
            ip("-n", self.switch, "link", "set", port, "master", "lan", "up")
            ip("-n", space, "address", "add", f"{address}/24", "dev", "lan0")
            for device in ("lo", "lan0"):
                ip("-n", space, "link", "set", device, "up")

    def remove(self) -> None:
        for process in self.processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
        for space in (*self.spaces.values(), self.switch):
            subprocess.run(["ip", "netns", "delete", space], capture_output=True, check=False)

    def block(self, first: str) -> Block:
        """The block of the page that begins with this line."""
        [found] = [block for block in self.blocks if block.text.startswith(first)]
        return found

    def prepare(self) -> None:
        """What the page does on the laptop that has the keys, and what it carries to each machine: no more than that one needs."""
        office = self.folder / "office" / "covey"
        office.mkdir(parents=True)
        (office / "lab.toml").write_text(self.block("# lab.toml").text)
        done = self.type(office, self.block("./covey keys --scenario lab.toml").text)
        assert done.wait(timeout=60.0) == 0, done.communicate()
        for address, name in NEEDED.items():
            machine = self.folder / address / "covey"
            machine.mkdir(parents=True)
            (machine.parent / "field-keys").mkdir()
            for file in ("run.toml", "agents.toml"):
                shutil.copy(office / file, machine)
            for file in ("ca.pem", f"{name}.pem", f"{name}.key"):
                shutil.copy(office.parent / "field-keys" / file, machine.parent / "field-keys")

    def on(self, address: str, text: str = "") -> "subprocess.Popen[str]":
        """What the page types on a machine, or another text."""
        space = self.spaces[address]
        return self.type(self.folder / address / "covey", text or self.block(f"# on {address}\n").text, "ip", "netns", "exec", space)

    def type(self, folder: Path, text: str, *before: str) -> "subprocess.Popen[str]":
        """A shell with the words of a page, where ./covey and .venv/bin/python are those of this checkout."""
        text = text.replace(".venv/bin/python", sys.executable).replace("./covey ", f"{sys.executable} -m deploy ")
        process = subprocess.Popen(
            [*before, "bash", "-e", "-c", f"{text}\nwait"],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT}/deploy/interface", "COVEY_RUNS": str(folder / "runs")},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.processes.append(process)
        return process

    def record(self, text: str) -> None:
        """Record for a while, and end it with Ctrl-C."""
        process = self.on("10.0.0.3", text)
        time.sleep(RECORDED)
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=30.0)


@pytest.fixture
def laptops(tmp_path: Path) -> Iterator[Laptops]:
    made = Laptops(tmp_path)
    try:
        made.build()
        yield made
    finally:
        made.remove()


def test_the_page_brings_a_swarm_onto_two_laptops_and_a_third_one_finds_watches_and_scores_it(laptops: Laptops) -> None:
    laptops.prepare()
    check, record, score = laptops.block("# on 10.0.0.3").text.splitlines()[1:]
    for address in ("10.0.0.1", "10.0.0.2"):
        laptops.on(address)
    look = f"until {check} > found.txt && grep -q 'run lab: found agent s1, agent s2, body s1, body s2' found.txt; do sleep 1; done"
    assert laptops.on("10.0.0.3", look).wait(timeout=100.0) == 0
    itself = laptops.on("10.0.0.1", "./covey check agents.toml --network --as s1")
    assert itself.wait(timeout=60.0) == 0, itself.communicate()
    laptops.record(record)
    output, complaints = laptops.on("10.0.0.3", score).communicate(timeout=60.0)
    assert "OSPA" in output, complaints
    recording = Recording(laptops.folder / "10.0.0.3" / "covey" / "field.mcap")
    said = [message for entry in recording.entries() for message in messages_of(event_of(entry)) if isinstance(message, Estimate)]
    assert {message.sender for message in said} == {"s1", "s2"}
    assert max(message.tick for message in said) - min(message.tick for message in said) > 10
    arena = 40.0 * 40.0
    last = {message.sender: message for message in said}
    assert sum(polygon_area(message.cell) for message in last.values()) == pytest.approx(arena, rel=0.05)
