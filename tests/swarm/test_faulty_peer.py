"""One agent of seven that says wrong things in valid messages: the others go on, and none of them is worse off than without it."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from agents.agent import Agent
from agents.membership.peer_table import MOST_STRANGERS
from deploy.scoring.result import Result
from deploy.simulation import Simulation
from protocol.fields import pack
from protocol.message import Message
from protocol.messages import Gossip, Hello
from protocol.node import Effect, Event
from tests.swarm.scene import tracking

LIAR, FROM = "s7", 20  # tick from which on it says wrong things
Lie = Callable[[Gossip], list[Message]]
NO_STATE = dict.fromkeys(("claim_bytes", "claim_ages", "states_bytes", "ids_bytes", "labels_bytes", "label_numbers_bytes"), b"")


def changed(said: Gossip, **fields: object) -> Gossip:
    return msgspec.structs.replace(said, **fields)


def silence(said: Gossip) -> list[Message]:
    return []


def claim_of_everything(said: Gossip) -> list[Message]:
    """A disc of 1000 km around the own COD, cut from another diagram than that of the others: it wins every conflict."""
    alone = {"claim_names": (LIAR,), "claim_bytes": pack(np.array([[*said.cod, 1e6]]), "<f8"), "claim_ages": b"", "diagram_hash": 7}
    return [changed(said, **alone) if said.claim_names else said]


def mass_without_end(said: Gossip) -> list[Message]:
    return [changed(said, weight=1e6) if said.ids_bytes else said]


def ticks_far_ahead(said: Gossip) -> list[Message]:
    return [changed(said, tick=said.tick + 1000, claim_tick=0)]


def wrong_ticks_beside_the_right_one(said: Gossip) -> list[Message]:
    return [*(changed(said, tick=said.tick + 1000 + number, claim_tick=0) for number in range(16)), said]


def made_up_names(said: Gossip) -> list[Message]:
    names = [f"x{10 * said.tick + number}" for number in range(10)]
    hellos = [Hello(sender=name, incarnation=1, sensor_class="A") for name in names]
    return [said, *hellos, *(changed(said, sender=name, claim_names=(), claim_tick=0, listening=True, **NO_STATE) for name in names)]


class Played(NamedTuple):
    """A run, and an honest agent at its end."""

    result: Result
    agent: Agent


@cache
def play(lie: Lie | None) -> Played:
    """A run of 20 s in which one agent says what a lie makes of each of its gossips."""

    class Liar(Agent):
        def handle(self, event: Event, now: float) -> list[Effect]:
            effects = super().handle(event, now)
            if lie is None or self.name != LIAR or self.tick < FROM:
                return effects
            return [said for effect in effects for said in (lie(effect) if isinstance(effect, Gossip) else [effect])]

    simulation = Simulation(tracking(team="A3,C2,D2"), build=Liar)
    return Played(simulation.run(), simulation.agents["s1"])


@pytest.mark.parametrize("lie", [claim_of_everything, mass_without_end, ticks_far_ahead])
def test_who_says_what_cannot_be_is_not_heard_and_costs_no_more_than_its_death(lie: Lie) -> None:
    found, dead = play(lie), play(silence)
    assert found.result.steady_ospa == pytest.approx(dead.result.steady_ospa, abs=0.3)
    assert found.agent.counters["late"] == dead.agent.counters["late"] == 4, "nobody waits for it after four rounds"


@pytest.mark.parametrize("lie", [wrong_ticks_beside_the_right_one, made_up_names])
def test_what_is_said_beside_right_gossips_changes_no_bit(lie: Lie) -> None:
    found, honest = play(lie), play(None)
    for part in ("mean_ospa", "final_ospa", "hole_area", "overlap_area", "mass_residual"):
        assert getattr(found.result, part) == getattr(honest.result, part)
    assert found.agent.counters["missing"] == 0
    assert len(found.agent.peer_table.peers) <= 6 + MOST_STRANGERS
