"""Births far away from the arena: an announced noise, or a stated pose, may place them anywhere."""

import math

import msgspec
import numpy as np
import pytest

from agents.agent import Agent
from agents.backend import PLAIN, Backend
from agents.compiled.backend import FAST
from agents.config import FilterSettings, PoseSettings
from protocol import codec
from protocol.fields import pack
from protocol.keys import message_key
from protocol.measuring import MeasurementModel
from protocol.message import Message
from protocol.messages import Gossip
from protocol.node import Alive, Effect, Started, Timer
from protocol.observer_messages import Estimate
from protocol.sensing import WedgeSensor
from tests.agents.test_agent import CONFIG, hello, see, word

CASES = {
    "the largest range noise": (MeasurementModel("range-bearing", 1.0, 1.0e6), 30.0, None),
    "the largest noise of a pose": (None, 30.0, (1.0e6, 1.0e6)),
    "a beam across the arena of a pose that may lie anywhere": (MeasurementModel("bearing", 1.0), 50.0, (1.0e6, 1.0e6)),
    "a sensor that reaches far, from far away": (MeasurementModel("range-bearing", 1.0, 1.0), 1.0e6, None),
}


def played(
    backend: Backend,
    measures: MeasurementModel | None,
    radius: float,
    pose_noise: tuple[float, float] | None,
    filters: FilterSettings = FilterSettings(),
) -> list[Message]:
    """The gossips and estimates of s1, with an s2 that carries such a sensor."""
    config = msgspec.structs.replace(CONFIG, pose=PoseSettings(position_noise=0.1), filter=filters)
    agent, said = Agent(config, "s1", backend=backend), list[Effect]()
    agent.handle(Started(), 0.0)
    agent.handle(Alive("agent", "s2", 1), 0.0)
    agent.handle(hello(sensor=WedgeSensor(1.0, radius, 0.9, measures)), 0.0)
    far = 1.0e6 - 10.0 if radius > 100.0 else 18.0
    seen = np.array([[far, math.pi], [far - 1.0, math.pi]] if measures else [[12.0, 20.0], [13.0, 20.0]])
    place = {"pose": (far + 12.0, 20.0, 0.0), "cod": (far + 12.0, 20.0), "pose_noise": pose_noise}
    for tick in range(4):
        said += agent.handle(see(tick), 0.25 * tick)
        said += agent.handle(word(tick, detections_bytes=pack(seen, "<f4"), **place), 0.25 * tick + 0.05)
        said += agent.handle(Timer(), 0.25 * tick + 0.2)
    assert agent.counters["rounds"] == agent.counters["heard"] == 4, agent.counters
    return [effect for effect in said if isinstance(effect, Gossip | Estimate)]


@pytest.mark.parametrize("case", CASES)
def test_they_fill_no_memory_and_count_the_same_in_both_correctors(case: str) -> None:
    """The grid on which misses are weighed spanned all places at which births might lie: one agent ended all the others."""
    assert played(PLAIN, *CASES[case]) == played(FAST, *CASES[case])


def test_components_of_any_width_are_stated_so_that_nobody_refuses_them() -> None:
    """Their factors have 16 bits. Agents that cannot state them were refused by each other, and silent."""
    noisy = played(PLAIN, *CASES["the largest noise of a pose"], FilterSettings(kind="gaussian-mixture"))
    gossips = [message for message in noisy if isinstance(message, Gossip)]
    assert max(float(np.abs(gossip.components["factor"]).max()) for gossip in gossips if gossip.components_bytes) == 65504.0
    for gossip in gossips:
        codec.decode(message_key(CONFIG.run.name, gossip), codec.encode(gossip))
