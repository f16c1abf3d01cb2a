"""Whole runs of the world with the smallest agents over the bus."""

import math

import msgspec
import pytest

from protocol.message import Message
from protocol.messages import Command, Hello, Observation
from protocol.node import Effect, Event, Node, Started, Stop, Subscribe, messages_of
from protocol.sensing import SENSOR_CLASSES
from protocol.virtual import VirtualBus
from tests.world.stage import POSES, config
from world.config import BodySettings, WorldConfig
from world.world import World


class Driver(Node):
    """The smallest agent: says hello and answers every observation by driving in a circle."""

    run, role = "covey", "agent"

    def __init__(self, name: str, incarnation: int = 1) -> None:
        self.name, self.incarnation = name, incarnation
        self.observations: list[Observation] = []
        self._heard: set[str] = set()

    def handle(self, event: Event, now: float) -> list[Effect]:
        if isinstance(event, Started):
            return [Subscribe("covey/covey/hello/*"), Subscribe(f"covey/covey/observation/{self.name}"), self._hello()]
        return [effect for message in messages_of(event) for effect in self._answer(message)]

    def _answer(self, message: Message) -> list[Effect]:
        if isinstance(message, Hello) and message.sender not in self._heard:
            self._heard.add(message.sender)
            return [self._hello()]
        if isinstance(message, Observation):
            self.observations.append(message)
            turn, speed = 0.3, 1.5
            way = speed * math.cos(message.pose[2]), speed * math.sin(message.pose[2])
            return [Command(sender=self.name, incarnation=self.incarnation, tick=message.tick, velocity=way, turn_rate=turn)]
        return []

    def deadline(self) -> float | None:
        return None

    def _hello(self) -> Message:
        return Hello(sender=self.name, incarnation=self.incarnation, heard=tuple(sorted(self._heard)), sensor=SENSOR_CLASSES["B"])


def drive(settings: WorldConfig, names: tuple[str, ...]) -> dict[str, list[Observation]]:
    bus = VirtualBus()
    agents = [Driver(name) for name in names]
    bus.add(World(settings, 1))
    for agent in agents:
        bus.add(agent)
    bus.run(until=100.0)
    assert bus.stopped["world"] == Stop(0, "done")
    return {agent.name: agent.observations for agent in agents}


def transcript(observations: list[Observation]) -> list[tuple[object, ...]]:
    return [(one.tick, one.time, one.pose, one.detections_bytes) for one in observations]


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_a_whole_run_over_the_bus_gives_every_agent_every_tick(clock: str) -> None:
    heard = drive(config(clock), ("s1", "s2"))
    for observations in heard.values():
        assert [one.tick for one in observations] == list(range(20))
    assert sum(len(one.detections) for one in heard["s1"]) > 0


def test_both_clocks_tell_the_same_story() -> None:
    lockstep, realtime = drive(config(), ("s1", "s2")), drive(config("realtime"), ("s1", "s2"))
    assert transcript(lockstep["s1"]) == transcript(realtime["s1"])
    assert transcript(lockstep["s2"]) == transcript(realtime["s2"])


def test_one_agent_more_changes_nobody_elses_dice() -> None:
    alone = drive(config(), ("s1", "s2"))
    settings = config()
    bigger = msgspec.structs.replace(
        settings,
        members={"s0": "D", **settings.members},
        bodies=BodySettings(start="given", poses={**POSES, "s0": (20.0, 20.0, 0.0)}),
    )
    crowded = drive(bigger, ("s0", "s1", "s2"))
    assert transcript(crowded["s1"]) == transcript(alone["s1"])
    assert transcript(crowded["s2"]) == transcript(alone["s2"])
    assert len(crowded["s0"]) == 20
