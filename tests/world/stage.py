"""A world of two agents on a stage of 40 m, and what is said to it, for its tests."""

from typing import TypeVar

import msgspec

from protocol.messages import Command, Hello
from protocol.node import Alive, Effect, Event, Received, Started, received
from protocol.settings import ArenaSettings, DetectionSettings
from world.config import BodySettings, TargetSettings, WorldConfig, WorldRun
from world.world import World

T = TypeVar("T")
POSES = {"s1": (10.0, 10.0, 0.0), "s2": (30.0, 30.0, 1.0)}


def config(clock: str = "lockstep", **run: object) -> WorldConfig:
    settings = {"seconds": 10.0, "dt": 0.5, "clock": clock, "patience": 5.0, "start_timeout": 60.0, **run}
    return WorldConfig(
        run=msgspec.convert(settings, WorldRun),
        arena=ArenaSettings(width=40.0, height=40.0),
        detection=DetectionSettings(clutter=0.5),
        members={"s1": "A", "s2": "B"},
        targets=TargetSettings(count=60, border="reflect"),
        bodies=BodySettings(start="given", poses=POSES),
    )


def hello(name: str, incarnation: int = 1, heard: tuple[str, ...] = ("s1", "s2", "world")) -> Received:
    return received(Hello(sender=name, incarnation=incarnation, heard=heard))


def command(name: str, tick: int, velocity: tuple[float, float] = (1.0, 0.0), incarnation: int = 1, turn_rate: float = 0.0) -> Received:
    return received(Command(sender=name, incarnation=incarnation, tick=tick, velocity=velocity, turn_rate=turn_rate))


def feed(world: World, *events: Event, now: float = 0.0) -> list[Effect]:
    return [effect for event in events for effect in world.handle(event, now)]


def of_kind(kind: type[T], effects: list[Effect]) -> list[T]:
    return [effect for effect in effects if isinstance(effect, kind)]


def started(settings: WorldConfig, now: float = 0.0) -> tuple[World, list[Effect]]:
    """A world with both members ready, and what it did at the start line."""
    world = World(settings, incarnation=1)
    feed(world, Started(), Alive("agent", "s1", 1), Alive("agent", "s2", 1), hello("s1"), now=now)
    return world, feed(world, hello("s2"), now=now)
