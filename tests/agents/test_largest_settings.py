"""Whatever the settings admit, the agent's own messages can be read: nobody is told why, if all refuse them."""

from typing import Any

import pytest

from agents.agent import Agent
from agents.config import AgentConfig
from protocol import codec
from protocol.fields import LARGEST_NUMBER
from protocol.keys import message_key
from protocol.message import Message
from protocol.messages import Gossip, Observation
from protocol.node import Effect, Started, Timer, received
from protocol.settings import BadSetting, convert

BARE = {"filter": {"prior_particles": 0.0, "prior_density": 0.0}}
CROWDED = {"arena": {"width": 30.0, "height": 30.0}, "filter": {"prior_density": 0.1}}
FAR = LARGEST_NUMBER / 2


def messages(settings: dict[str, Any], pose: tuple[float, float, float]) -> list[Message]:
    """What an agent says in its first ticks, as its peers read it."""
    agent = Agent(convert({"members": {"s1": "X"}, "run": {"clock": "lockstep"}, **settings}, AgentConfig, "team.toml"), "s1")
    effects: list[Effect] = agent.handle(Started(), 0.0)
    for tick in range(6):
        observation = Observation(sender="world", incarnation=1, recipient="s1", tick=tick, time=0.0, pose=pose)
        effects += [*agent.handle(received(observation), 1.0 + 9.0 * tick), *agent.handle(Timer(), 8.0 + 9.0 * tick)]
    return [codec.decode(message_key("covey", said), codec.encode(said)) for said in effects if isinstance(said, Message)]


@pytest.mark.parametrize(
    ("settings", "pose"),
    [
        ({"limits": {"turn_rate": 1.0e4, "speed": 1.0e4}, "pose": {"time_noise": 10.0}}, (50.0, 50.0, 0.0)),
        ({"arena": {"width": FAR, "height": FAR}, "sensors": {"X": {"angle": 20.0, "radius": FAR}}, **BARE}, (FAR, FAR, 0.8)),
        ({"control": {"mode": "search-and-track"}, "search": {"capacity": 1.0e-9}, **CROWDED}, (15.0, 15.0, 0.0)),
    ],
)
def test_peers_read_the_messages_of_an_agent_with_the_largest_settings(settings: dict[str, Any], pose: tuple[float, float, float]) -> None:
    found = messages({"sensors": {"X": {"angle": 90.0, "radius": 8.0}}, **settings}, pose)
    assert sum(isinstance(message, Gossip) for message in found) == 6


@pytest.mark.parametrize(
    ("section", "field", "value", "largest"),
    [("limits", "turn_rate", 1.0e7, "10000.0"), ("arena", "width", 3.0e6, "500000.0"), ("arena", "height", 6.0e5, "500000.0")],
)
def test_a_setting_whose_messages_all_would_refuse_is_refused_by_name(section: str, field: str, value: float, largest: str) -> None:
    with pytest.raises(BadSetting, match=rf"^team.toml: {section}\.{field} = {value}: should be .*<= {largest}"):
        convert({section: {field: value}}, AgentConfig, "team.toml")
