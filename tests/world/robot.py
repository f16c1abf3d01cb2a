"""A robot that answers what a test wants, a body that drives it, and the commands to that body."""

from typing import Any

import pytest

from deploy.scenario import Scenario, resolve, world_config
from protocol.messages import Command
from protocol.node import Alive, Started, received
from world.body import Body
from world.config import WorldConfig

ROBOT = f"{__name__}:Robot"


class Robot:
    """A platform that notes what it is told and answers what a test wants."""

    answer: Any = ((5.0, 5.0, 0.0), None)
    told: list[Any]

    def __init__(self, name: str) -> None:
        Robot.told = []

    def read(self, tick: int) -> Any:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def drive(self, velocity: tuple[float, float], turn_rate: float) -> None:
        self.told.append((velocity, turn_rate))

    def stop(self) -> None:
        self.told.append("stop")


def config(platform: str = ROBOT, **settings: object) -> WorldConfig:
    scenario: Scenario = resolve("quick", {"team.composition": "A2", "bodies.host": "own", "bodies.platform": platform, **settings})
    return world_config(scenario)


def started(monkeypatch: pytest.MonkeyPatch, answer: Any = ((5.0, 5.0, 0.0), None), **settings: object) -> Body:
    monkeypatch.setattr(Robot, "answer", answer)
    body = Body(config(**{"bodies.epoch": 100.0, "run.clock": "realtime", **settings}), "s1", 1, 100.0)
    body.handle(Started(), 0.0)
    body.handle(Alive("agent", "s1", 1), 0.0)
    return body


def command(tick: int, velocity: tuple[float, float] = (1.0, 0.0), incarnation: int = 1) -> Any:
    return received(Command(sender="s1", incarnation=incarnation, tick=tick, velocity=velocity, turn_rate=0.5))
