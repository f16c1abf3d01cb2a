"""The fence: no command leads a body farther out of the arena than it allows."""

import pytest

from protocol.node import Timer
from tests.world.robot import Robot, command, started
from world.platform import fenced


def test_the_fence_shortens_what_leads_out_and_leaves_what_leads_back(monkeypatch: pytest.MonkeyPatch) -> None:
    box = (-1.0, -1.0, 11.0, 11.0)
    assert fenced((2.0, 1.0), (5.0, 5.0, 0.0), box, 0.5) == (2.0, 1.0)
    assert fenced((2.0, 1.0), (10.5, 5.0, 0.0), box, 0.5) == (1.0, 1.0)
    assert fenced((-2.0, 2.0), (-0.5, 10.5, 0.0), box, 0.5) == (-1.0, 1.0)
    assert fenced((2.0, -2.0), (11.5, -1.5, 0.0), box, 0.5) == (0.0, 0.0)
    assert fenced((-2.0, 2.0), (11.5, -1.5, 0.0), box, 0.5) == (-2.0, 2.0)
    body = started(monkeypatch, ((43.0, 5.0, 0.0), None), **{"bodies.fence": 3.0, "arena.width": 40.0})
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.1)
    assert Robot.told == [((0.0, 0.0), 0.5)]


def test_the_fence_holds_in_a_run_that_is_faster_than_its_world(monkeypatch: pytest.MonkeyPatch) -> None:
    """At rate 8 a simulated body moves for 8 s of the world in the second for which a command counts."""
    body = started(monkeypatch, ((39.0, 5.0, 0.0), None), **{"bodies.fence": 1.0, "arena.width": 40.0, "bodies.hold": 1.0, "run.rate": 8.0})
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.01)
    assert Robot.told == [((0.25, 0.0), 0.5)]
