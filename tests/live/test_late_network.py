"""A network that is late: every process in a network namespace of its own, and a relay that carries each packet between them.

The namespaces are hosts of one subnet. The interface of each is a TUN device, whose other end the relay holds. What an agent sends to an
agent arrives `late` seconds later, and all else at once: the world and the recorder hear everybody in time, as with the fault `delay`.
No code of Covey takes part in that, so Zenoh's own handshakes and tokens are late as well. TCP controls its congestion by CUBIC, as Linux
does by default, whatever this machine has been set to: with BBR late links leave holes.
"""

import ctypes
import fcntl
import heapq
import json
import os
import random
import select
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.recording.recording import Recording
from deploy.recording.rescore import rescore
from deploy.scoring.scores import Score
from tests.live.harness import BOUND, ROOT
from tests.live.test_namespaces import WHY_NOT, ip

NO_TUN = "" if WHY_NOT or os.access("/dev/net/tun", os.W_OK) else "needs /dev/net/tun"
pytestmark = [
    pytest.mark.live,
    pytest.mark.namespaces,
    pytest.mark.slow,
    pytest.mark.alone,
    pytest.mark.nightly,
    pytest.mark.skipif(bool(WHY_NOT or NO_TUN), reason=WHY_NOT or NO_TUN),
    pytest.mark.timeout(300),
]
CLONE_NEWNET = 0x40000000
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
AGENTS = tuple(f"s{number}" for number in range(1, 9))
SECONDS, DT = 45.0, 0.5
LATE = 1.2  # s
SETTLED = 25.0  # s of world time; by then the agents have found each other and measured the lag
SUDDENLY = 30.0  # s after the processes were started
HEALED = 100.0  # s of world time; TCP has got used to its longer ways for half a minute by then
TEAM = ("--team", "A2,C4,D2", "--targets", "8", "--set", "arena.width=50", "--set", "arena.height=50")
OPTIONS = (*TEAM, "--dt", str(DT), "--rate", "1", "--set", "timing.look_ahead=2.5", "--set", "network.lease=30")


class LateNetwork:
    """The namespaces, the relay and the processes.

    `late`: how many seconds every packet between two agents takes; `loss`: the share of them that never arrives.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.protocol, self.late, self.loss = folder, "udp", 0.0, 0.0
        hosts = [*AGENTS, "world", "recorder"]
        self.addresses = {name: f"10.214.0.{number}" for number, name in enumerate(hosts, 1)}
        self.spaces = {name: f"covey-{os.getpid()}-{name}" for name in hosts}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._devices: dict[str, int] = {}
        self._removed = threading.Event()
        self._relay = threading.Thread(target=self._carry)

    def build(self) -> None:
        for name, space in self.spaces.items():
            ip("netns", "add", space)
            self._devices[name] = _tun_in(space)
            ip("-n", space, "address", "add", f"{self.addresses[name]}/24", "dev", "net0")
            for device in ("lo", "net0"):
                ip("-n", space, "link", "set", device, "up")
            ip("-n", space, "route", "replace", "10.214.0.0/24", "dev", "net0", "src", self.addresses[name], "congctl", "cubic")
        self._relay.start()

    def endpoint(self, name: str) -> str:
        return f"{self.protocol}/{self.addresses[name]}:7447"

    def start(self, name: str, *words: str) -> None:
        command = ["ip", "netns", "exec", self.spaces[name], sys.executable, "-P", "-m", *words]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "COVEY_RUNS": str(self.folder)}
        with (self.folder / f"{name}.log").open("wb") as log:
            self.processes[name] = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def play(self, seed: int, seconds: float = SECONDS) -> list[Score]:
        """Write the configurations, run a swarm until its world ends, and score its recording."""
        options = (*OPTIONS, "--seconds", str(seconds), "--seed", str(seed), "--run", "late", "--set", "network.insecure=true")
        seeds = (self.endpoint("world"), self.endpoint("s1"))
        recorder_network = {"listen": [self.endpoint("recorder")], "seeds": seeds}
        recorder_options = [word for key, value in recorder_network.items() for word in ("--set", f"network.{key}={json.dumps(value)}")]
        for file, words in (("run.toml", ()), ("agents.toml", ("--agents",)), ("recorder.toml", recorder_options)):
            command = [sys.executable, "-P", "-m", "deploy", "config", "efficacy", *options, *words]
            text = subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True, capture_output=True).stdout
            (self.folder / file).write_bytes(text)
        # UDP has no "connection refused": a process that dials one that is not running yet tries again after a minute
        for name in ("world", *AGENTS):
            config = self.folder / ("run.toml" if name == "world" else "agents.toml")
            role = ("world",) if name == "world" else ("agents", "--name", name)
            dials = [word for seed in seeds if seed != self.endpoint(name) for word in ("--seed-endpoint", seed)]
            self.start(name, *role, "--config", str(config), "--listen", self.endpoint(name), *dials)
        self.start("recorder", "deploy", "record", str(self.folder / "late.mcap"), "--run", str(self.folder / "recorder.toml"))
        assert self.processes["world"].wait(seconds + BOUND) == 0, (self.folder / "world.log").read_text()
        self.processes["recorder"].send_signal(signal.SIGINT)
        assert self.processes["recorder"].wait(BOUND) == 0, (self.folder / "recorder.log").read_text()
        return rescore(Recording(self.folder / "late.mcap")).scores

    def _carry(self) -> None:
        """The relay: hands each packet to the device of its destination, now or when it is due."""
        poll, names = select.epoll(), {device: name for name, device in self._devices.items()}
        for device in names:
            poll.register(device, select.EPOLLIN)
        devices = {bytes(map(int, address.split("."))): self._devices[name] for name, address in self.addresses.items()}
        waiting: list[tuple[float, int, int, bytes]] = []  # a heap: due at, s; number of the packet, which keeps the order; device; packet
        number, dice = 0, random.Random(5)
        while not self._removed.is_set():
            now = time.monotonic()
            while waiting and waiting[0][0] <= now:
                _, _, device, packet = heapq.heappop(waiting)
                os.write(device, packet)
            for source, _ in poll.poll(min(0.1, waiting[0][0] - now) if waiting else 0.1):
                packet = os.read(source, 65536)
                destination = devices.get(packet[16:20])
                if packet[0] >> 4 != 4 or destination is None:
                    continue
                between_agents = names[source] in AGENTS and names[destination] in AGENTS
                if between_agents and dice.random() < self.loss:
                    continue
                number += 1
                heapq.heappush(waiting, (time.monotonic() + (self.late if between_agents else 0.0), number, destination, packet))

    def remove(self) -> None:
        for process in self.processes.values():
            process.kill()
            process.wait()
        self._removed.set()
        if self._relay.ident is not None:
            self._relay.join()
        for device in self._devices.values():
            os.close(device)
        for space in self.spaces.values():
            subprocess.run(["ip", "netns", "delete", space], capture_output=True, check=False)


def _tun_in(space: str) -> int:
    """The descriptor of a new device `net0` in a namespace. It carries packets of IP, and works from this namespace, too."""
    setns = ctypes.CDLL(None, use_errno=True).setns
    with open("/proc/thread-self/ns/net", "rb") as own, open(f"/run/netns/{space}", "rb") as other:
        assert setns(other.fileno(), CLONE_NEWNET) == 0, os.strerror(ctypes.get_errno())
        try:
            device = os.open("/dev/net/tun", os.O_RDWR)
            fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH14x", b"net0", IFF_TUN | IFF_NO_PI))
        finally:
            assert setns(own.fileno(), CLONE_NEWNET) == 0, os.strerror(ctypes.get_errno())
    return device


@pytest.fixture
def network(tmp_path: Path) -> Iterator[LateNetwork]:
    made = LateNetwork(tmp_path)
    try:
        made.build()
        yield made
    finally:
        made.remove()


def largest_hole(scores: list[Score], since: float) -> float:
    """The largest share of the arena that nobody covers from `since` s of world time on."""
    settled = [score for score in scores if score.tick * DT >= since]
    worst = max(settled, key=lambda score: score.hole)
    print(f"the largest hole {100.0 * worst.hole:.1f} %, the largest overlap {100.0 * max(score.overlap for score in settled):.1f} %")
    return worst.hole


@pytest.mark.parametrize("protocol", ["udp", "tcp"])
def test_a_swarm_whose_packets_are_late_leaves_no_hole(network: LateNetwork, protocol: str) -> None:
    network.protocol, network.late = protocol, LATE
    scores = network.play(1)
    assert len(scores) == round(SECONDS / DT)
    assert largest_hole(scores, SETTLED) <= 0.05  # with messages that come in time it is 0; a busy machine adds to the delay


def test_over_tcp_a_swarm_whose_packets_become_late_all_at_once_comes_together_again(network: LateNetwork) -> None:
    network.protocol = "tcp"
    later = threading.Timer(SUDDENLY, lambda: setattr(network, "late", 2.0))
    later.start()
    try:
        scores = network.play(1, HEALED + 20.0)
    finally:
        later.cancel()
    assert max(score.hole for score in scores if score.tick * DT >= SUDDENLY) > 0.0, "the delay did harm at first"
    assert largest_hole(scores, HEALED) <= 0.05


def test_over_tcp_a_swarm_on_a_radio_that_loses_packets_hardly_leaves_holes(network: LateNetwork) -> None:
    network.protocol, network.late, network.loss = "tcp", 0.02, 0.02
    settled = [score for score in network.play(1) if score.tick * DT >= SETTLED]
    assert sum(score.hole for score in settled) <= 0.02 * len(settled)
    assert sum(score.overlap for score in settled) <= 0.02 * len(settled)
