"""Valid messages and tokens of made-up names: an agent keeps a fixed number of such names, in whatever it keeps."""

import msgspec
import pytest

from agents.agent import Agent
from agents.config import TimingSettings
from agents.gossip.round_inbox import WINDOW_TICKS
from agents.membership.agreement import MOST_WARNINGS
from agents.membership.peer_table import MOST_STRANGERS
from protocol.fields import MAX_NAMES
from protocol.messages import Beacon, Hello
from protocol.node import Alive, Effect, Gone, Timer, Warn, received
from tests.agents.test_agent import CONFIG, LOCKSTEP, hello, met, only, see, word
from tests.names import names_in

MANY = 3 * MOST_STRANGERS
ROOMS = "agents", "protocol"


def flood(agent: Agent, first: int, now: float) -> list[Effect]:
    """Names from the number `first` on: an agent without a token, one whose token comes and goes, a body, one with other settings."""
    effects: list[Effect] = []
    for number in range(first, first + MANY, 4):
        speaker, passing, body, other = (f"x{number + place}" for place in range(4))
        events = [hello(speaker), word(agent.tick + 1, speaker), Alive("agent", passing, 1), hello(passing), Gone("agent", passing, 1)]
        events += [Alive("body", body, 1), Gone("body", body, 1), hello(other, settings={"arena": {"width": float(number)}})]
        for event in events:
            effects += agent.handle(event, now)
    return effects


def test_an_agent_that_hears_everybody_keeps_a_fixed_number_of_made_up_names() -> None:
    agent, warned = met(), 0
    for tick in range(6):
        now = 0.5 * tick
        agent.handle(see(tick), now)
        agent.handle(word(tick), now)
        warned += sum(isinstance(effect, Warn) for effect in flood(agent, MANY * tick, now))
        due = agent.deadline()
        agent.handle(Timer(), now if due is None else max(now, due))
    agent.handle(Timer(), 60.0)
    assert {"s2"} < agent.peer_table.peers.keys() and len(agent.peer_table.peers) == 1 + MOST_STRANGERS
    assert warned == MOST_WARNINGS
    most = 2 * MOST_STRANGERS + MOST_WARNINGS  # those of the last round, those of now, and those that a warning has named
    assert MOST_STRANGERS <= len(names_in(agent, *ROOMS)) <= most < 2 * MANY


def test_its_own_hello_lists_the_names_that_it_keeps_and_no_others() -> None:
    agent = met()
    agent.handle(see(0), 0.0)
    flood(agent, 0, 0.1)
    due = agent.deadline()
    assert due is not None
    greeting = only(agent.handle(Timer(), max(due, 2.0)), Hello)
    assert isinstance(greeting, Hello) and "s2" in greeting.heard and 100 < len(greeting.heard) <= 1 + MOST_STRANGERS


@pytest.mark.parametrize("tick", [1, 2**40])
def test_an_agent_that_hears_its_neighbours_forgets_made_up_names_whatever_tick_they_say(tick: int) -> None:
    agent = Agent(msgspec.structs.replace(LOCKSTEP, timing=TimingSettings(interest="neighbours")), "s1")
    usual = {"position": (1.0, 1.0), "cod": (2.0, 1.0), "power_radius": 1.0, "reach": 8.0, "column": 0, "row": 0, "sensor_class": "B"}
    said = [Beacon(sender=f"x{number}", incarnation=1, tick=tick, **usual) for number in range(40)]  # type: ignore[arg-type]
    for own in range(3 * WINDOW_TICKS):
        agent.handle(see(own), 0.5 * own)
        if own < 3:
            agent.handle(received(*said), 0.5 * own)
            assert len(agent.peer_table.peers) == 40
        for _ in range(8):
            due = agent.deadline()
            if due is None or due > 0.5 * own + 0.5:
                break
            agent.handle(Timer(), due)
    assert agent.tick == 3 * WINDOW_TICKS - 1 and not agent.peer_table.peers and not names_in(agent.peer_table, *ROOMS)


def test_names_in_beacons_push_out_those_that_have_been_silent_for_longest() -> None:
    agent = Agent(msgspec.structs.replace(LOCKSTEP, timing=TimingSettings(interest="neighbours")), "s1")
    usual = {"position": (1.0, 1.0), "cod": (2.0, 1.0), "power_radius": 1.0, "reach": 8.0, "column": 0, "row": 0, "sensor_class": "B"}
    agent.handle(see(0), 0.0)

    def say(*names: str) -> None:
        agent.handle(received(*[Beacon(sender=name, incarnation=1, tick=0, **usual) for name in names]), 0.0)  # type: ignore[arg-type]

    say("g2", "g3")
    for first in range(0, MAX_NAMES, MAX_NAMES // 4):
        say("g2")
        say(*(f"x{first + number}" for number in range(MAX_NAMES // 4)))
    assert len(agent.peer_table.peers) == MAX_NAMES
    assert "g2" in agent.peer_table.peers and "g3" not in agent.peer_table.peers and "x0" not in agent.peer_table.peers


def test_an_agent_without_observations_keeps_a_fixed_number_of_gossips() -> None:
    """Its body has died; with the look-ahead gossips wait for the round that is played late."""
    agent = met(msgspec.structs.replace(CONFIG, timing=TimingSettings(look_ahead=2.0)))
    agent.handle(see(0), 0.0)
    kept = []
    for tick in range(300):
        agent.handle(word(tick), 0.5 * tick)
        kept.append(len(agent._rounds.recent._said))
    assert 0 < max(kept) == kept[-1] < 100
    assert agent._rounds.recent.has_later("s2", 298), "the newest are kept"
