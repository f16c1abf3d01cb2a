"""The rules that the body of a robot keeps: ticks, what its agent is told, when it stands, and what it makes of wrong words."""

import itertools
import math
import struct
from typing import Any

import msgpack
import pytest

from deploy.bridge.body import MOST_PLACES, RobotBody, Rules
from deploy.bridge.client import Heard
from protocol import codec
from protocol.messages import Observation
from tests.names import names_in


class Desk:
    """A body at tick 0 of a run whose ticks last 0.25 s, with what it has said and whether its token is up."""

    def __init__(self, **changed: Any) -> None:
        self.said: list[dict[str, Any]] = []
        self.up = False
        time: dict[str, Any] = {"dt": 0.25, "period": 0.25, "anchor": 100.0, "patience": 60.0, "strict": False}
        rules = Rules("s3", ("s1", "s2", "s3"), **time, hold=0.5, speed=2.0, turn_rate=5.0)._replace(**changed)
        self.body = RobotBody(rules, 50, lambda kind, fields: self.said.append({"kind": kind, **fields}), self._appear)
        self.body.hear(Heard("agent", "s3", {}, 7), 99.0)

    def _appear(self, up: bool) -> None:
        self.up = up

    def among(self, *names: str) -> "Desk":
        """This desk, where these have an agent and a body."""
        for role, name in itertools.product(("agent", "body"), names):
            self.body.hear(Heard(role, name, {}, 1), 99.0)
        return self

    def at(self, now: float, pose: tuple[float, float, float] = (1.0, 2.0, 0.5)) -> None:
        """Odometry and an empty scan, and a look at the clock."""
        self.body.at(pose, now)
        self.body.sees([(3.0, 4.0)], now)
        self.body.step(now)

    def command(
        self, now: float, tick: int = 0, incarnation: int = 7, velocity: tuple[float, float] = (1.0, 0.0), turn: float = 0.3
    ) -> None:
        self.body.hear(Heard("command", "s3", {"tick": tick, "velocity": velocity, "turn_rate": turn}, incarnation), now)


def test_what_a_body_says_is_an_observation_that_the_swarm_reads() -> None:
    desk = Desk()
    desk.at(99.9)
    assert desk.up and not desk.said, "tick 0 has not begun"
    desk.at(100.51)
    [said] = desk.said
    assert said.pop("kind") == "observation"
    packed = {"type": "observation", "sender": "s3", "incarnation": 50, "wire": 2, **said}
    seen = codec.decode("covey/r/observation/s3", msgpack.packb(packed))
    assert isinstance(seen, Observation)
    assert (seen.tick, seen.time, seen.pose, seen.detections.tolist()) == (2, 0.5, (1.0, 2.0, 0.5), [[3.0, 4.0]])


def test_each_scan_of_a_slow_detector_is_told_once_and_the_body_is_there_between_two_of_them() -> None:
    """One scan a second; ticks of 0.25 s. Two scans have shown how slow it is. Without a third one the body goes after 2 s."""
    desk = Desk()
    desk.body.sees([(3.0, 4.0)], 99.0)
    for tick in range(13):
        now = 100.0 + 0.25 * tick
        desk.body.at((1.0, 2.0, 0.5), now)
        if tick in (0, 4):
            desk.body.sees([(3.0, 4.0)], now)
        desk.body.step(now)
        assert desk.up
    assert [(said["scanned"], len(said["detections"])) for said in desk.said] == [
        (True, 8) if tick in (0, 4) else (False, 0) for tick in range(13)
    ]
    desk.body.at((1.0, 2.0, 0.5), 103.3)
    desk.body.step(103.3)
    assert not desk.up


def test_a_body_with_a_size_says_its_pose_and_tells_its_agent_of_those_that_did() -> None:
    desk = Desk(sight=5.0)
    for name, x in (("s1", 5.0), ("s2", 6.1), ("s3", 1.0), ("s4", math.nan)):
        desk.body.hear(Heard("pose", name, {"tick": 0, "pose": (x, 2.0, 0.0)}, 7), 99.0)
    desk.at(100.0)
    pose, observation = desk.said
    assert pose == {"kind": "pose", "tick": 0, "pose": (1.0, 2.0, 0.5)}
    assert struct.unpack("<2d", observation["obstacles"]) == (5.0, 2.0)


def test_a_command_moves_the_body_for_half_a_second_and_is_cut_to_the_limits() -> None:
    desk = Desk()
    desk.at(100.0)
    desk.command(100.0, velocity=(6.0, 8.0), turn=9.0)
    velocity, turn = desk.body.motion(100.4)
    assert velocity == pytest.approx((1.2, 1.6)) and turn == 5.0
    desk.at(100.49)
    assert desk.body.motion(100.501) == ((0.0, 0.0), 0.0)


@pytest.mark.parametrize(("sight", "moves"), [(0.0, True), (5.0, False)])
def test_among_bodies_with_a_size_a_command_ends_two_ticks_after_its_own(sight: float, moves: bool) -> None:
    desk = Desk(sight=sight)
    desk.at(100.0)
    desk.command(100.2)
    desk.at(100.3)
    assert desk.body.motion(100.49) != ((0.0, 0.0), 0.0)
    assert (desk.body.motion(100.51) != ((0.0, 0.0), 0.0)) == moves


def test_after_the_last_tick_it_stands_and_says_nothing() -> None:
    desk = Desk(ticks=2)
    for now in (100.0, 100.25):
        desk.at(now)
    desk.command(100.3, tick=1)
    assert desk.body.motion(100.4) != ((0.0, 0.0), 0.0)
    desk.at(100.5)
    assert desk.body.over and len(desk.said) == 2 and desk.body.motion(100.5) == ((0.0, 0.0), 0.0)


@pytest.mark.parametrize(
    ("tick", "incarnation", "velocity"), [(1, 7, (1.0, 0.0)), (0, 6, (1.0, 0.0)), (0, 7, (math.nan, 0.0))], ids=["to come", "older", "nan"]
)
def test_a_command_of_a_tick_to_come_of_an_older_incarnation_or_that_is_no_number_moves_nothing(
    tick: int, incarnation: int, velocity: tuple[float, float]
) -> None:
    desk = Desk()
    desk.at(100.0)
    desk.command(100.0, tick, incarnation, velocity)
    assert desk.body.motion(100.1) == ((0.0, 0.0), 0.0)


def test_a_body_stands_while_a_halt_holds_when_its_agent_has_gone_and_when_it_is_blind() -> None:
    desk = Desk()
    desk.at(100.0)
    desk.command(100.0)
    assert desk.body.motion(100.1) != ((0.0, 0.0), 0.0)
    desk.body.hear(Heard("halt", "operator-1", {"held": True}, 9), 100.1)
    assert desk.body.motion(100.1) == ((0.0, 0.0), 0.0)
    desk.body.hear(Heard("halt", "operator-1", {"held": False}, 8), 100.1)
    assert desk.body.motion(100.1) == ((0.0, 0.0), 0.0), "an older order"
    desk.body.hear(Heard("halt", "operator-2", {"held": False}, 10), 100.1)
    assert desk.body.motion(100.1) != ((0.0, 0.0), 0.0)
    desk.body.hear(Heard("agent", "s3", {}, 7, up=False), 100.1)
    assert desk.body.motion(100.1) == ((0.0, 0.0), 0.0)
    blind = Desk(hold=10.0)
    blind.at(100.0)
    blind.command(100.0)
    assert blind.body.motion(100.45) != ((0.0, 0.0), 0.0)
    blind.body.step(100.6)
    assert blind.body.motion(100.6) == ((0.0, 0.0), 0.0) and not blind.up, "no odometry for 0.6 s"
    assert len(blind.said) == 1
    blind.at(100.7)
    assert blind.up


def test_a_clock_follows_the_majority_of_those_who_speak_forward_at_once_and_back_only_from_afar() -> None:
    for skew, tick in ((0.0, 4), (0.2, 5), (-0.2, 4), (-3.0, 4)):  # others ahead by 0.2 s: jump; behind by 0.2 s: as it was; by 3 s: stand
        desk = Desk().among("s1", "s2", "s4")
        desk.at(100.0)
        for name in ("s1", "s2", "s4"):
            desk.body.hear(Heard("gossip", name, {"tick": 4}, 1), 101.0 - skew)
        desk.at(101.06)
        assert desk.body.tick == (tick if skew > -1.0 else 0), skew
    late = Desk(anchor=None, patience=math.inf).among("s1")
    late.at(200.0)
    assert late.body.tick == -1
    late.body.hear(Heard("gossip", "s1", {"tick": 4000}, 1), 200.0)
    late.at(200.3)
    assert late.body.tick == 4001


def test_neither_one_neighbour_of_several_nor_anybody_else_moves_a_clock() -> None:
    desk = Desk().among("s1", "s2")
    desk.at(100.0)
    desk.body.hear(Heard("gossip", "s1", {"tick": 4000}, 1), 100.0)
    desk.at(100.3)
    assert desk.body.tick == 1, "s2 has not spoken"
    far = Desk().among("s4", "s5", "s6", "s7", "s8", "t1", "t2")
    far.at(100.0)
    for name in ("s1", "s2", "s4", "s5", "t1", "t2"):  # two without tokens, two of the five next in the ring, and two beyond
        far.body.hear(Heard("gossip", name, {"tick": 4000}, 1), 100.0)
    far.at(100.3)
    assert far.body.tick == 1
    for name in ("s4", "s6", "s8"):
        far.body.hear(Heard("gossip", name, {"tick": 4001}, 1), 100.3)
    far.at(100.4)
    assert far.body.tick == 4001


def test_a_run_of_robots_alone_begins_when_all_agents_and_bodies_are_there() -> None:
    desk = Desk(anchor=None)
    for role, name in (("agent", "s1"), ("agent", "s2"), ("body", "s1")):
        desk.body.hear(Heard(role, name, {}, 1), 10.0)
    desk.at(20.0)
    assert desk.body.tick == -1
    desk.body.hear(Heard("body", "s2", {}, 1), 20.0)
    desk.at(20.9)
    assert desk.body.tick == -1
    desk.at(21.1)
    assert desk.body.tick == 0


def test_a_younger_body_of_the_name_ends_the_older_one() -> None:
    desk = Desk()
    desk.body.hear(Heard("body", "s3", {}, 49), 100.0)
    assert not desk.body.replaced
    desk.body.hear(Heard("body", "s3", {}, 51), 100.0)
    assert desk.body.replaced


@pytest.mark.parametrize("strict", [False, True])
def test_after_its_patience_a_run_begins_without_those_who_are_missing_and_a_strict_one_ends(strict: bool) -> None:
    desk = Desk(anchor=None, strict=strict)
    desk.body.hear(Heard("agent", "s1", {}, 1), 120.0)
    desk.at(179.0)
    assert (desk.body.tick, desk.body.incomplete) == (-1, False)
    desk.body.hear(Heard("agent", "s1", {}, 0, up=False), 179.0)  # puts nothing off
    desk.at(180.1)
    assert (desk.body.tick, desk.body.incomplete) == ((-1, True) if strict else (0, False))


def test_the_end_of_an_older_agent_leaves_the_command_of_the_younger_one_in_force() -> None:
    desk = Desk()
    desk.body.hear(Heard("agent", "s3", {}, 8), 99.5)
    desk.at(100.0)
    desk.command(100.0, incarnation=8)
    desk.body.hear(Heard("agent", "s3", {}, 7, up=False), 100.1)
    assert desk.body.motion(100.2) != ((0.0, 0.0), 0.0)
    desk.body.hear(Heard("agent", "s3", {}, 9), 100.2)
    assert desk.body.motion(100.2) == ((0.0, 0.0), 0.0), "the command was that of an older one"


@pytest.mark.parametrize("far", [1e308, 2e6, -math.inf, math.nan])
def test_what_a_driver_says_for_nothing_is_no_place(far: float) -> None:
    desk = Desk()
    desk.body.at((1.0, 2.0, 0.5), 100.0)
    desk.body.at((far, 2.0, 0.5), 100.0)
    desk.body.sees([(3.0, far), (3.0, 4.0), *[(5.0, 6.0)] * MOST_PLACES], 100.0)
    desk.body.step(100.0)
    [said] = desk.said
    scan = list(struct.iter_unpack("<2f", said["detections"]))
    assert said["pose"] == (1.0, 2.0, 0.5) and len(scan) == MOST_PLACES and scan[:2] == [(3.0, 4.0), (5.0, 6.0)]


@pytest.mark.parametrize("tick", [math.inf, math.nan, -1, 1 << 60, True, 4.0])
def test_a_tick_that_is_none_moves_no_clock(tick: object) -> None:
    desk = Desk(ticks=1000).among("s1")
    desk.at(100.0)
    desk.body.hear(Heard("gossip", "s1", {"tick": tick}, 1), 100.0)
    desk.at(100.3)
    assert desk.body.tick == 1


def test_names_that_have_gone_leave_nothing_behind() -> None:
    desk = Desk()
    for number in range(2 * MOST_PLACES):
        name = f"x{number}"
        for up in (True, False):
            desk.body.hear(Heard("agent", name, {}, 1, up), 100.0)
            desk.body.hear(Heard("gossip", name, {"tick": 1}, 1), 100.0)
        desk.body.hear(Heard("pose", f"y{number}", {"tick": 1, "pose": (1.0, 1.0, 0.0)}, 1), 100.0)
    assert names_in(desk.body, "deploy") == {f"y{number}" for number in range(MOST_PLACES)}
