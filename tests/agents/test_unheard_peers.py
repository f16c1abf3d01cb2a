"""What is known of others but not heard from them: far generators, unknown claimants, changed senders, sensors out of reach."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from agents.backend import PLAIN
from agents.config import AgentConfig
from agents.coverage.cells import cut
from agents.coverage.control import Lloyd
from agents.gossip.table import GossipTable, announced_sensor
from agents.interest.position_table import UnsubscribedGenerators
from agents.membership.peer import plausible
from agents.round import AgentContext, _nearby_sensors, _own_cell
from agents.tracking.belief import Copies, ParticlePhd
from agents.tracking.particles import NO_PARTICLES
from agents.tracking.tracker import Belief
from protocol.fields import pack
from protocol.geometry import rectangle
from protocol.messages import Gossip
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import ArenaSettings
from tests.agents.gossip_table import table
from tests.agents.test_belief import merged, owned_state, particles

CONFIG = AgentConfig()
ARENA = rectangle(100.0, 100.0)
SENSOR = SENSOR_CLASSES["A"]  # sees 8 m far
ME = AgentContext("s1", SENSOR, announced_sensor("s1", SENSOR, 0.0), Lloyd(), PLAIN, ParticlePhd(PLAIN), CONFIG, ARENA, "A")


def said(name: str, x: float, y: float) -> Gossip:
    return Gossip(sender=name, incarnation=1, tick=5, pose=(x, y, 0.0), cod=(x, y), power_radius=0.0, unused=0.0)


def speaking() -> GossipTable:
    return table([said("s1", 20.0, 50.0), said("s2", 60.0, 50.0), said("s4", 20.0, 90.0)])


def test_generators_that_are_known_but_not_heard_bound_the_cell_and_stand_in_the_claim() -> None:
    """s1 at 20 m, s2 at 60 m, and s3, of which a beacon told, at 30 m: the border is at 25 m."""
    far = UnsubscribedGenerators(np.array([[30.0, 50.0, 0.0]]), ("s2", "s3", "s4"), np.array([True, False, True]))
    polygon, claim = _own_cell(ME, speaking(), far)
    assert polygon[:, 0].max() == 25.0
    assert claim.names[0] == "s1" and set(claim.names) == {"s1", "s3", "s4"}
    places = np.array([[20.0, 50.0], [60.0, 50.0], [20.0, 90.0], [30.0, 50.0]])
    assert np.array_equal(polygon, cut(0, places, np.zeros(4), ARENA).polygon)


def test_only_sensors_that_reach_the_region_around_the_cell_are_fields() -> None:
    """The cell ends at 40 m, its halo at 46 m; s2 sees 8 m far. Beyond 54 m it is none."""
    for x, number in ((53.9, 2), (54.1, 1)):
        words = table([said("s1", 20.0, 50.0), said("s2", x, 50.0)])
        cell = cut(0, np.array([[20.0, 50.0], [60.0, 50.0]]), np.zeros(2), ARENA)
        assert len(_nearby_sensors(ME, cell.polygon, words)) == number


def test_the_claim_of_a_stranger_never_agrees_with_mine_whatever_view_it_states() -> None:
    """s2, unknown until now, claims what lies beyond 50 m, and I what lies before 60 m; both say the same view."""
    mine = owned_state("s1", particles((1, 49.0, 0.1), (2, 58.0, 0.1)), {"s1": (30.0, 50.0, 0.0), "s3": (90.0, 50.0, 0.0)}, diagram_hash=7)
    theirs = owned_state("s2", particles((4, 59.0, 0.1)), diagram_hash=7)
    belief = Belief(4, mine, Copies(NO_PARTICLES), frozenset({"s1", "s3"}), frozenset({"s3"}))
    assert merged(belief, [theirs]) == [1, 4]
    assert merged(replace(belief, known_names=frozenset({"s2", "s3"})), [theirs]) == [1, 2, 4]


def test_each_bound_of_what_a_sensor_can_do_is_kept_by_itself() -> None:
    """Class A: D = 132.7 m^2, g(D) = 6.499 m, the COD lies within 8 m, and the goal in the arena of 100 x 80 m."""
    announced = announced_sensor("s2", SENSOR, 0.1)
    most, radius = announced.facts.capability, math.sqrt(announced.facts.capability / math.pi)
    usual = {"unused": most, "power_radius": radius, "cod": (8.0, 0.0), "goal": (100.0, 80.0)}
    odd = {"unused": 1.001 * most, "power_radius": 1.001 * radius, "cod": (8.01, 0.0), "goal": (80.0, 80.1)}
    arena = ArenaSettings(width=100.0, height=80.0)

    def is_plausible(**fields: Any) -> bool:
        return plausible(Gossip(sender="s2", incarnation=1, tick=5, pose=(0.0, 0.0, 0.0), **{**usual, **fields}), announced, arena)

    def claim(radius: float) -> dict[str, Any]:
        return {"claim_names": ("s2", "s3"), "claim_bytes": pack(np.array([[8.0, 0.0, radius], [9.0, 0.0, 1e6]]), "<f8")}

    assert is_plausible(**claim(radius)) and is_plausible(**claim(-radius))
    assert not is_plausible(**claim(1.001 * radius)) and not is_plausible(**claim(-1.001 * radius))
    assert is_plausible()
    assert is_plausible(goal=None)
    assert {field: is_plausible(**{field: value}) for field, value in odd.items()} == dict.fromkeys(odd, False)
