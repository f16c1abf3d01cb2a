"""What gossips say side by side: rows, generators of the three diagrams, scans and particles, computed once for all who ask."""

import numpy as np
import pytest

from agents.config import AgentConfig, PartitionSettings
from agents.gossip.table import COS_HALF, REACH, GossipTable
from protocol.fields import pack
from protocol.gaussian_components import COMPONENT
from protocol.messages import Gossip
from protocol.random_streams import random_key
from protocol.sensing import SENSOR_CLASSES
from tests.agents.gossip_table import table

DOTS = np.array([[1.5, 2.5], [3.5, 4.5]])
KINDS = ("power", "voronoi-cod", "voronoi")
CONFIGS = {kind: AgentConfig(partition=PartitionSettings(kind=kind)) for kind in KINDS}  # type: ignore[arg-type]


def gossip(name: str, cod: float = 3.0, radius: float = 2.0, **fields: object) -> Gossip:
    return Gossip(  # type: ignore[arg-type]
        sender=name, incarnation=1, tick=5, pose=(10.0, 20.0, 0.0), cod=(10.0 + cod, 20.0), power_radius=radius, unused=0.0, **fields
    )


def words(*gossips: Gossip, kind: str = "power") -> GossipTable:
    return table(gossips, SENSOR_CLASSES["B"], CONFIGS[kind])


@pytest.mark.parametrize(
    "kind, generators",
    [
        ("power", [[13.0, 20.0, 2.0], [14.0, 20.0, 1.0]]),
        ("voronoi-cod", [[13.0, 20.0, 0.0], [14.0, 20.0, 0.0]]),
        ("voronoi", [[10.0, 20.0, 0.0], [10.0, 20.0, 0.0]]),
    ],
)
def test_the_three_diagrams_of_the_same_gossips(kind: str, generators: list[list[float]]) -> None:
    said = words(gossip("s2"), gossip("s3", cod=4.0, radius=1.0), kind=kind)
    assert said.names == ("s2", "s3") and said.generators.tolist() == generators


def test_the_view_depends_on_every_generator_and_every_name() -> None:
    views = {words(gossip("s2"), gossip(name, cod=cod)).diagram_hash for name in ("s3", "s4") for cod in (4.0, 4.0 + 1e-15 * 8)}
    assert len(views) == 4 and 0 not in views


def test_scans_keep_their_order_and_the_silent_are_left_out() -> None:
    said = words(gossip("s2", detections_bytes=pack(DOTS, "<f4")), gossip("s3", scanned=False), gossip("s4"))
    assert [(len(scan.detections), scan.salt) for scan in said.scans()] == [
        (2, random_key("sensor", "s2")),
        (0, random_key("sensor", "s4")),
    ]
    assert said.detections.tolist() == DOTS.tolist() and said.salts.tolist() == [random_key("sensor", name) for name in said.names]


def test_particles_stand_end_to_end_with_their_senders_weights() -> None:
    held = {"claim_names": ("s2",), "claim_bytes": pack(np.zeros((1, 3)), "<f8"), "diagram_hash": 7, "claim_tick": 4}
    one = gossip("s2", weight=0.5, states_bytes=pack(np.ones((2, 4)), "<f4"), ids_bytes=pack(np.array([3, 9]), "<u8"), **held)
    other = gossip("s3", diagram_hash=7, claim_tick=4)
    said = words(one, other)
    assert said.particles.ids.tolist() == [3, 9] and said.particles.weights.tolist() == [0.5, 0.5]
    assert said.common_diagram == (4, 7) and words(one, gossip("s3", diagram_hash=8, claim_tick=4)).common_diagram is None
    assert words().particles.states.shape == (0, 4) and words().generators.shape == (0, 3)


def test_who_hears_the_same_shares_what_is_computed_but_not_across_diagrams() -> None:
    first, second = gossip("s2"), gossip("s3", cod=4.0)
    assert words(first, second) is words(first, second)
    assert words(first, second) is not words(first, second, kind="voronoi")


def test_the_same_gossips_from_other_sensors_are_another_table() -> None:
    said = [gossip("s2"), gossip("s3", cod=4.0)]
    first, second = (table(said, sensors=[SENSOR_CLASSES[each], SENSOR_CLASSES["B"]]) for each in ("A", "B"))
    assert first.table[0, REACH] == second.table[0, REACH] and first.table[0, COS_HALF] != second.table[0, COS_HALF]


def test_a_swarm_may_state_more_components_than_a_gossip_may() -> None:
    """The limit of 4096 is one of a gossip: 140 agents with 30 components each stay within it."""
    rows = np.zeros(30, COMPONENT)
    said = []
    for number in range(140):
        rows["id"] = np.arange(30) + 30 * number
        said.append(gossip(f"s{number + 1}", components_bytes=rows.tobytes()))
    assert words(*said).components["id"].tolist() == list(range(4200))
