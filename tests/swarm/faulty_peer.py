"""One agent of seven that says wrong things in valid messages, and what that costs the swarm.

python -m tests.swarm.faulty_peer     the table of docs/explanation/faulty-peers.md
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import msgspec
import numpy as np

from agents.agent import Agent
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
    hellos = [Hello(sender=name, incarnation=1, sensor_class="D") for name in names]  # as the sender, or nobody could see so much
    return [said, *hellos, *(changed(said, sender=name, claim_names=(), claim_tick=0, listening=True, **NO_STATE) for name in names)]


def no_detections(said: Gossip) -> list[Message]:
    return [changed(said, detections_bytes=b"")]


def no_capacity(said: Gossip) -> list[Message]:
    return [changed(said, power_radius=0.0, unused=0.0)]


def another_place(said: Gossip) -> list[Message]:
    """The middle of the arena."""
    (x, y, heading), (east, north) = said.pose, said.cod
    return [changed(said, pose=(20.0, 20.0, heading), cod=(east + 20.0 - x, north + 20.0 - y))]


def false_mass(said: Gossip) -> list[Message]:
    """1000 expected targets in the own cell, the most that a gossip may hold."""
    return [changed(said, weight=8000.0 / len(said.ids_bytes)) if said.ids_bytes else said]


def false_detections(said: Gossip) -> list[Message]:
    """100 all over the arena."""
    places = np.random.default_rng(said.tick).uniform(0.0, 40.0, (100, 2))
    return [changed(said, detections_bytes=pack(places, "<f4"))]


def many_false_detections(said: Gossip) -> list[Message]:
    """1000 all over the arena."""
    places = np.random.default_rng(said.tick).uniform(0.0, 40.0, (1000, 2))
    return [changed(said, detections_bytes=pack(places, "<f4"))]


def one_place_a_thousand_times(said: Gossip) -> list[Message]:
    """1000 detections of the middle of the arena."""
    return [changed(said, detections_bytes=pack(np.full((1000, 2), 20.0), "<f4"))]


def particles_in_other_cells(said: Gossip) -> list[Message]:
    """2000 particles of 20 expected targets all over the arena."""
    numbers = np.random.default_rng(said.tick)
    states, ids = numbers.uniform(0.0, 40.0, (2000, 4)), np.sort(numbers.integers(1, 2**63, 2000))
    stated = {**NO_STATE, "states_bytes": pack(states, "<f4"), "ids_bytes": pack(ids, "<u8"), "weight": 0.01}
    return [changed(said, **{**stated, "claim_bytes": said.claim_bytes, "claim_ages": said.claim_ages}) if said.claim_names else said]


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


def main() -> None:
    """Print the table."""
    lies = [None, silence, no_detections, no_capacity, another_place, false_mass, particles_in_other_cells, false_detections]
    lies += [many_false_detections, one_place_a_thousand_times]
    lies += [claim_of_everything, mass_without_end, ticks_far_ahead, wrong_ticks_beside_the_right_one, made_up_names]
    for lie in lies:
        found = play(lie).result
        name = lie.__name__.replace("_", " ") if lie else "honest"
        print(f"| {name} | {found.steady_ospa:.2f} | {found.cardinality_error:.1f} | {100.0 * found.hole_area:.0f} % |")


if __name__ == "__main__":
    main()
