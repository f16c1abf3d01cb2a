"""Bodies with a radius: where they start, and which others a body senses."""

import math
from itertools import combinations

import msgspec
import pytest

from deploy.scenario import resolve, world_config
from protocol.messages import BodyPose, Observation
from protocol.node import Alive, Gone, Started, Subscribe, Timer, received
from protocol.settings import BadSetting, LimitSettings
from tests.world.stage import config, hello, of_kind, started
from world.bodies import CLEARANCE, check_given, start_poses
from world.body import Body
from world.config import BodySettings, WorldConfig
from world.proximity import around, sight
from world.witness import Witness
from world.world import World


def stage(apart: float, radius: float = 0.5) -> WorldConfig:
    poses = {"s1": (10.0, 10.0, 0.0), "s2": (10.0 + apart, 10.0, 1.0)}
    return msgspec.structs.replace(config(), limits=LimitSettings(radius=radius), bodies=BodySettings(start="given", poses=poses))


def seen(settings: WorldConfig) -> dict[str, list[list[float]]]:
    _, effects = started(settings)
    return {observation.recipient: observation.obstacles.tolist() for observation in of_kind(Observation, effects)}


def test_a_body_senses_the_middle_of_another_one_in_sight() -> None:
    assert sight(stage(3.0)) == 2.0 * 0.5 + 8.0 * 2.0 * 0.5
    assert seen(stage(8.9)) == {"s1": [[18.9, 10.0]], "s2": [[10.0, 10.0]]}
    assert seen(stage(9.1)) == {"s1": [], "s2": []}


def test_who_is_told_a_wrong_pose_is_told_of_obstacles_where_they_are_from_there() -> None:
    settings = stage(2.0)
    wrong = msgspec.structs.replace(settings.bodies, position_error=0.3, heading_error=0.05)
    _, effects = started(msgspec.structs.replace(settings, bodies=wrong))
    told = {observation.recipient: observation for observation in of_kind(Observation, effects)}
    for name, ahead in (("s1", 0.0), ("s2", math.pi - 1.0)):
        (x, y, heading), [[east, north]] = told[name].pose, told[name].obstacles.tolist()
        assert math.hypot(east - x, north - y) == pytest.approx(2.0, abs=1e-5)
        assert math.remainder(math.atan2(north - y, east - x) - heading - ahead, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-5)
        assert (x, y) != {"s1": (10.0, 10.0), "s2": (12.0, 10.0)}[name]


def test_points_sense_nothing() -> None:
    assert seen(stage(1.0, radius=0.0)) == {"s1": [], "s2": []}


def test_the_wreck_of_an_agent_that_is_not_there_is_sensed() -> None:
    world = World(stage(3.0), 1)
    world.expect(("s1",))
    effects = [effect for event in (Started(), Alive("agent", "s1", 1)) for effect in world.handle(event, 0.0)]
    effects += world.handle(hello("s1", heard=("world",)), 0.0)
    [observation] = of_kind(Observation, effects)
    assert observation.obstacles.tolist() == [[13.0, 10.0]]


def test_a_body_process_says_where_it_is_and_tells_its_agent_of_another_one_that_did_even_when_that_is_gone() -> None:
    given = {"bodies.start": "given", "bodies.poses": {"s1": [10.0, 10.0, 0.0], "s2": [12.0, 10.0, 0.0]}, "run.clock": "realtime"}
    own = {"team.composition": "A2", "bodies.host": "own", "limits.radius": 0.3, "bodies.epoch": 100.0}
    body = Body(world_config(resolve("quick", {**own, **given})), "s1", 1, 100.0)
    body.handle(Started(), 0.0)
    body.handle(Alive("agent", "s1", 1), 0.0)
    body.handle(Alive("body", "s2", 1), 0.0)
    body.handle(received(BodyPose(sender="s2", incarnation=1, tick=0, pose=(12.0, 10.0, 0.0))), 0.0)
    body.handle(Gone("body", "s2", 1), 0.0)
    pose, observation = body.handle(Timer(), 0.0)
    assert isinstance(pose, BodyPose) and (pose.sender, pose.tick, pose.pose) == ("s1", 0, (10.0, 10.0, 0.0))
    assert isinstance(observation, Observation) and observation.obstacles.tolist() == [[12.0, 10.0]]


def test_points_say_no_pose() -> None:
    body = Body(world_config(resolve("quick", {"team.composition": "A2", "bodies.host": "own", "run.clock": "realtime"})), "s1", 1, 100.0)
    assert "covey/covey/pose/*" not in [effect.expression for effect in body.handle(Started(), 0.0) if isinstance(effect, Subscribe)]


def test_bodies_start_with_room_around_them_and_every_process_knows_where() -> None:
    crowd = world_config(resolve("quick", {"team.composition": "A20", "limits.radius": 0.8, "run.seed": 4}))
    poses = start_poses(crowd)
    assert min(math.dist(one[:2], other[:2]) for one, other in combinations(poses.values(), 2)) >= 2.0 * (0.8 + CLEARANCE)
    assert World(crowd, 1).bodies.poses == poses
    assert Witness(crowd, "monitor", 1, 4, 0.0)._poses == poses
    points = world_config(resolve("quick", {"team.composition": "A20", "run.seed": 4}))
    assert sum(poses[name] == pose for name, pose in start_poses(points).items()) >= 10  # who had room stayed


def test_an_arena_without_room_and_given_poses_that_overlap_are_refused_in_one_line() -> None:
    with pytest.raises(BadSetting, match=r"limits.radius = 8: the arena has no room for"):
        start_poses(world_config(resolve("quick", {"team.composition": "A20", "limits.radius": 8.0})))
    with pytest.raises(BadSetting, match=r"bodies.poses.s1: lies 1.00 m from s2; should be 1.2 m at least"):
        check_given(stage(1.0))
    check_given(stage(1.2))  # 11.2 - 10.0 is a little less than 1.2


def test_sight_keeps_the_order_and_may_be_empty() -> None:
    assert around((0.0, 0.0, 0.0), [(1.0, 0.0), (90.0, 0.0), (0.0, 1.0)], stage(3.0)).tolist() == [[1.0, 0.0], [0.0, 1.0]]
    assert around((0.0, 0.0, 0.0), [], stage(3.0)).shape == (0, 2)
