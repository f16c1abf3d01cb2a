"""A real partition: two sides in network namespaces, the link between them down for 6 s, while both still see the world.

Three namespaces that the test makes and removes: `a` and `b` with three agents each, `w` with the world and an observer.

    a --- aw/wa --- w --- wb/bw --- b          agents listen on their address towards the world
    a --- ab/ba --------------------b          the way between the agents, and what goes down
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from shapely.geometry import Polygon
from shapely.ops import unary_union

from tests.live.harness import BOUND, ROOT

WHY_NOT = (
    "needs Linux"
    if sys.platform != "linux"
    else "needs root, for it makes network namespaces"
    if os.geteuid() != 0
    else "needs the command ip (iproute2)"
    if shutil.which("ip") is None
    else ""
)
pytestmark = [
    pytest.mark.live,
    pytest.mark.namespaces,
    pytest.mark.slow,
    pytest.mark.alone,
    pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT),
    pytest.mark.timeout(300),
]
SIDES = {"a": ("s1", "s2", "s3"), "b": ("s4", "s5", "s6")}
TEAM = SIDES["a"] + SIDES["b"]
AREA = 60.0 * 60.0  # m^2
CUT = 6.0  # s
RECONNECTED = 3.0  # s, the promise of docs/evidence/promises.md
CONFIG = f"""
[run]
name = "apart"
seconds = 100000.0
dt = 0.25
rate = 0.5
[arena]
width = 60.0
height = 60.0
[network]
insecure = true
[members]
{chr(10).join(f'{name} = "{sensor}"' for name, sensor in zip(TEAM, "AABAAB"))}
"""
WORLD = {"a": "tcp/10.213.1.254:7440", "b": "tcp/10.213.2.254:7441"}  # where the world listens towards each side
SEEDS = {"a": "tcp/10.213.1.1:7442", "b": "tcp/10.213.2.1:7443"}  # where the first agent of each side listens
OBSERVER = """
import sys, time
from deploy.cli.listener import Listener
from deploy.cli.message_text import plain_line
from protocol import live
from protocol.settings import NetworkSettings
def heard(what, now):
    print(time.monotonic(), plain_line(what), flush=True)
    return True
settings = NetworkSettings(listen=("tcp/10.213.1.254:0", "tcp/10.213.2.254:0"), seeds=tuple(sys.argv[1:]), insecure=True)
live.run(Listener("apart", "observer", "covey/apart/estimate/*", heard), settings)
"""


def ip(*words: str) -> None:
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.fail(f"ip {' '.join(words)}: {done.stderr.strip()}")


class Network:
    """The namespaces, what runs in them, and what the observer has heard."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.spaces = {short: f"covey-{os.getpid()}-{short}" for short in "abw"}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.estimates: dict[int, dict[str, tuple[float, Polygon]]] = {}  # by tick and name: when it was heard, and the cell
        self._read = 0

    def build(self) -> None:
        for space in self.spaces.values():
            ip("netns", "add", space)
            ip("-n", space, "link", "set", "lo", "up")
        for number, side in ((1, "a"), (2, "b")):
            self._pair(side, f"{side}w", f"10.213.{number}.1/24", "w", f"w{side}", f"10.213.{number}.254/24")
        self._pair("a", "ab", "10.213.3.1/24", "b", "ba", "10.213.3.2/24")
        self._way_from_a()
        ip("-n", self.spaces["b"], "route", "replace", "10.213.1.1/32", "via", "10.213.3.1", "src", "10.213.2.1")

    def _pair(self, one: str, link: str, address: str, other: str, far_link: str, far_address: str) -> None:
        near, far = self.spaces[one], self.spaces[other]
        ip("link", "add", link, "netns", near, "type", "veth", "peer", "name", far_link, "netns", far)
        for space, name, own in ((near, link, address), (far, far_link, far_address)):
            ip("-n", space, "address", "add", own, "dev", name)
            ip("-n", space, "link", "set", name, "up")

    def _way_from_a(self) -> None:
        """A link that goes down takes its routes with it."""
        ip("-n", self.spaces["a"], "route", "replace", "10.213.2.1/32", "via", "10.213.3.2", "src", "10.213.1.1")

    def cut(self) -> None:
        ip("-n", self.spaces["a"], "link", "set", "ab", "down")

    def heal(self) -> None:
        ip("-n", self.spaces["a"], "link", "set", "ab", "up")
        self._way_from_a()

    def start(self, space: str, name: str, *words: str) -> None:
        command = ["ip", "netns", "exec", self.spaces[space], sys.executable, *words]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
        with (self.folder / f"{name}.out").open("wb") as out, (self.folder / f"{name}.err").open("wb") as err:
            self.processes[name] = subprocess.Popen(command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=out, stderr=err)

    def start_all(self) -> None:
        config = self.folder / "run.toml"
        config.write_text(CONFIG, encoding="utf-8")
        for side, names in SIDES.items():
            address = SEEDS[side].rpartition(":")[0]
            for name in names:
                listen = SEEDS[side] if name == names[0] else f"{address}:0"
                seeds = [WORLD[side], *(seed for seed in SEEDS.values() if seed != listen)]
                dial = [word for seed in seeds for word in ("--seed-endpoint", seed)]
                self.start(side, name, "-m", "agents", "--name", name, "--config", str(config), "--listen", listen, *dial)
        self.start("w", "observer", "-c", OBSERVER, *WORLD.values(), *SEEDS.values())
        listens = [word for endpoint in WORLD.values() for word in ("--listen", endpoint)]
        dials = [word for seed in SEEDS.values() for word in ("--seed-endpoint", seed)]
        self.start("w", "world", "-m", "world", "--config", str(config), *listens, *dials)

    def wait(self, condition: Callable[[dict[str, tuple[float, Polygon]]], bool], since: float) -> float:
        """The time, s, at which the observer had heard the first tick, all of it later than `since`, that fulfils the condition."""
        end = time.monotonic() + BOUND
        while time.monotonic() < end:
            for name, process in self.processes.items():
                assert process.poll() is None, f"{name} ended: {(self.folder / f'{name}.err').read_text()[-2000:]}"
            self._read_on()
            for tick in sorted(self.estimates):
                said = self.estimates[tick]
                if len(said) == len(TEAM) and min(when for when, _ in said.values()) > since and condition(said):
                    return max(when for when, _ in said.values())
            time.sleep(0.05)
        newest = {tick: sorted(said) for tick, said in sorted(self.estimates.items())[-3:]}
        raise AssertionError(f"not reached; the newest ticks: {newest}")

    def _read_on(self) -> None:
        with (self.folder / "observer.out").open(encoding="utf-8") as file:
            file.seek(self._read)
            while (line := file.readline()).endswith("\n"):
                self._read = file.tell()
                when, _, text = line.partition(" ")
                message = json.loads(text)
                cell = Polygon(message["cell"]) if len(message["cell"]) > 2 else Polygon()
                self.estimates.setdefault(message["tick"], {})[message["sender"]] = float(when), cell

    def remove(self) -> None:
        for process in self.processes.values():
            process.kill()
        for process in self.processes.values():
            process.wait()
        for space in self.spaces.values():
            subprocess.run(["ip", "netns", "delete", space], capture_output=True, check=False)


@pytest.fixture
def network(tmp_path: Path) -> Iterator[Network]:
    made = Network(tmp_path)
    try:
        made.build()
        yield made
    finally:
        made.remove()


def covered(said: dict[str, tuple[float, Polygon]], names: tuple[str, ...]) -> float:
    """Share of the arena that the cells of these agents cover together."""
    return float(unary_union([said[name][1] for name in names]).area) / AREA


def claims(said: dict[str, tuple[float, Polygon]]) -> float:
    """How many claims there are per place, in the mean over the arena."""
    return sum(cell.area for _, cell in said.values()) / AREA


def one_claim_per_place(said: dict[str, tuple[float, Polygon]]) -> bool:
    return abs(claims(said) - 1.0) < 1e-6 and covered(said, TEAM) > 1.0 - 1e-6


def no_place_is_claimed_by_both_sides(said: dict[str, tuple[float, Polygon]]) -> bool:
    """Rounds in which somebody was late leave slivers unowned or owned twice; sides that do not hear each other overlap everywhere."""
    sides = [unary_union([said[name][1] for name in names]) for names in SIDES.values()]
    return float(sides[0].intersection(sides[1]).area) < 0.05 * AREA


def each_side_covers_all(said: dict[str, tuple[float, Polygon]]) -> bool:
    return abs(claims(said) - 2.0) < 1e-6 and all(covered(said, names) > 1.0 - 1e-6 for names in SIDES.values())


def test_each_side_of_a_partition_covers_the_arena_and_after_the_heal_there_is_one_claim_per_place(network: Network) -> None:
    network.start_all()
    network.wait(one_claim_per_place, 0.0)
    cut_at = time.monotonic()
    network.cut()
    apart = network.wait(each_side_covers_all, cut_at) - cut_at
    time.sleep(max(0.0, cut_at + CUT - time.monotonic()))
    network.wait(each_side_covers_all, time.monotonic() - 1.0)  # and so it has stayed
    healed_at = time.monotonic()
    network.heal()
    together = network.wait(no_place_is_claimed_by_both_sides, healed_at) - healed_at
    exact = network.wait(one_claim_per_place, healed_at) - healed_at
    print(f"each side covered the arena {apart:.2f} s after the cut; together {together:.2f} s, exact {exact:.2f} s after the heal")
    assert apart <= CUT, "a dead link must not hold up the live ones"
    assert together <= RECONNECTED
