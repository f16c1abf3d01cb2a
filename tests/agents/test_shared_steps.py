"""Steps of a round that both backends share a definition of: what they must give, not only that they agree."""

import math

import numpy as np
import pytest

from agents.backend import PLAIN, Backend
from agents.compiled import run_columns
from agents.compiled.backend import prepared
from agents.compiled.correction_kernels import _raster
from agents.config import AgentConfig, BirthSettings, FilterSettings, PartitionSettings
from agents.coverage.cells import cut
from agents.gossip.table import CLUTTER_DENSITY, GossipTable
from agents.tracking.births import Scan, measurement_births
from agents.tracking.claims import claim_of, end_to_end, make_claim
from agents.tracking.merge import united
from agents.tracking.particles import NO_PARTICLES, Particles, unlabelled
from agents.tracking.phd import sample_offset
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput, RegionUpdate
from deploy.simulation import compiled
from protocol.fields import pack
from protocol.geometry import rectangle
from protocol.keys import order
from protocol.messages import Gossip
from protocol.random_streams import random_key
from protocol.sensing import SENSOR_CLASSES, WedgeSensor
from protocol.settings import ArenaSettings, DetectionSettings
from tests.agents.gossip_table import table

BOTH = pytest.mark.parametrize("backend", [PLAIN, compiled()], ids=["plain", "compiled"])
SENSOR = WedgeSensor(math.pi, 20.0, 0.9)
POSE = (10.0, 30.0, 0.0)
CONFIG = AgentConfig(
    arena=ArenaSettings(width=60.0, height=60.0),
    detection=DetectionSettings(noise=0.5, clutter=2.0),
    filter=FilterSettings(speed=1e-9, heading_noise=0.0, position_noise=0.0, lifetime=0.0),
    birth=BirthSettings(background=False, measurement=False),
)


def particles(*rows: tuple[float, float, float]) -> Particles:
    """Slow particles at x, y of some weight, with ids 1, 2, ..."""
    table = np.array(rows, dtype=float).reshape(-1, 3)
    states = np.column_stack([table[:, :2], np.full((len(table), 2), 1e-9)])
    return unlabelled(states, table[:, 2].copy(), np.arange(1, len(table) + 1, dtype=np.uint64))


def said(name: str, pose: tuple[float, float, float], *detections: tuple[float, float], cod: tuple[float, float] | None = None) -> Gossip:
    return Gossip(
        sender=name,
        incarnation=1,
        tick=5,
        pose=pose,
        cod=cod or pose[:2],
        power_radius=0.0,
        unused=0.0,
        detections_bytes=pack(np.array(detections, dtype=float).reshape(-1, 2), "<f4"),
    )


def table_of(gossips: list[Gossip]) -> GossipTable:
    return table(gossips, SENSOR, CONFIG)


def updated(backend: Backend, density: Particles, table: GossipTable, polygon: np.ndarray) -> RegionUpdate:
    """What s1 with this cell makes of some particles."""
    claim = make_claim(("s1",), np.array([[10.0, 30.0, 0.0]]))
    return backend.update_regions(table, density, NO_PARTICLES, [RegionInput("s1", 0, SENSOR, POSE, polygon, claim)], Step(CONFIG, 5))[0]


@BOTH
def test_the_load_counts_what_lies_in_the_footprint_far_from_the_cell_too(backend: Backend) -> None:
    """The cell ends at x = 12 m and its halo at 18 m; of what lies beyond nobody else's scan is applied here."""
    cell = rectangle(12.0, 60.0)
    told = particles((11.0, 30.0, 0.2), (25.0, 30.0, 0.4), (25.0, 55.0, 0.8), (5.0, 30.0, 1.6))  # in the cell, far, out of reach, behind
    found = updated(backend, told, table_of([said("s1", POSE)]), cell)
    assert found.load == pytest.approx(0.2 * (1.0 - 0.9) / (1.0 - 0.9 * 0.2) + 0.4)
    assert found.detected == pytest.approx(0.9 * found.load)
    assert sorted(found.updated.ids.tolist()) == [1, 4]


@BOTH
def test_a_detection_shares_its_unit_of_mass_between_a_particle_and_clutter(backend: Backend) -> None:
    """r (1 - p) / (1 - r p) + f, f = w p g / (kappa + w p g), r = w - f, g = exp(-d^2 / (2 s^2)) / (2 pi s^2), kappa = clutter / area."""
    weight, apart, noise, probability = 0.3, 1.65, 0.5, 0.9
    words = table_of([said("s1", POSE, (20.0 + apart, 30.0))])
    found = updated(backend, particles((20.0, 30.0, weight)), words, rectangle(60.0, 60.0))
    kappa = 2.0 / (math.pi * 20.0**2 / 2.0)
    likelihood = math.exp(-(apart**2) / (2.0 * noise**2)) / (2.0 * math.pi * noise**2)
    seen = weight * probability * likelihood
    share = seen / (kappa + seen)
    rest = weight - share
    assert 0.05 < share < 0.25
    after = rest * (1.0 - probability) / (1.0 - probability * rest) + share
    assert found.updated.weights.tolist() == pytest.approx([after], rel=1e-5)


@BOTH
def test_a_miss_is_weighed_against_what_may_be_one_target(backend: Backend) -> None:
    """Two particles within reach of each other's squares are one target of .6 or of .2 + .9, which is no more than certain; a third far
    off is another; what is out of view is not missed."""
    words = table_of([said("s1", POSE)])
    places = (20.5, 30.5, 0.2), (22.5, 30.5, 0.4), (20.5, 40.5, 0.2), (20.5, 38.5, 0.9), (25.5, 20.5, 0.3), (5.0, 30.0, 0.5)
    found = updated(backend, particles(*places), words, rectangle(60.0, 60.0))
    factors = [0.1 / (1.0 - 0.9 * rest) for rest in (0.6, 0.6, CONFIG.filter.certainty, CONFIG.filter.certainty, 0.3)]
    expected = [weight * factor for (_, _, weight), factor in zip(places, [*factors, 1.0])]
    assert found.updated.weights.tolist() == pytest.approx(expected, rel=1e-12)


def test_the_bins_in_which_a_miss_is_weighed_cover_what_scans_reach_and_no_more() -> None:
    """Particles lie along 1 km, and s1 reaches 20 m."""
    east, detections = np.linspace(0.0, 1000.0, 101), np.array([[12.0, 30.0], [9.0, 30.0]])
    settings = prepared(CONFIG)[0].copy()
    settings[[run_columns.MISS_BIN, run_columns.WIDTH, run_columns.HEIGHT]] = 0.5, 1000.0, 60.0
    for found, spreads in ((detections[:0], np.zeros(0)), (detections, np.array([0.0, 4.0]))):
        raster = _raster(east, np.full(101, 30.0), found, spreads, table_of([said("s1", POSE)]).table, np.array([0]), settings)
        left, low, shape = raster[0], raster[1], raster[2].shape
        assert (left, low) == (-2, 58 if not len(found) else 50)
        assert shape == (5 if not len(found) else 21, 66)


@BOTH
def test_what_a_detection_accounts_for_is_not_missed_too(backend: Backend) -> None:
    """A sure target that is detected has its unit of mass and no more, where the PHD filter leaves it 2 - p_d."""
    words = table_of([said("s1", POSE, (20.0, 30.0))])
    found = updated(backend, particles((20.0, 30.0, 1.0)), words, rectangle(60.0, 60.0))
    kappa = 2.0 / (math.pi * 20.0**2 / 2.0)
    share = 0.9 / (2.0 * math.pi * 0.25) / (kappa + 0.9 / (2.0 * math.pi * 0.25))
    assert found.mass == pytest.approx(share + (1.0 - share) * 0.1 / (1.0 - 0.9 * (1.0 - share)), rel=1e-12)
    assert 0.99 < found.mass < 1.0


@BOTH
def test_the_eye_that_sees_least_is_heard_first_whatever_its_name(backend: Backend) -> None:
    told = particles((20.0, 30.0, 0.8), (20.7, 30.0, 0.3))
    scans = (("bad", 0.5, (20.1, 30.0)), ("good", 0.95, (20.5, 30.0)))
    after = []
    for names in (("s1", "s2"), ("s2", "s1")):
        gossips = []
        for name, (_, probability, place) in zip(names, scans):
            gossips.append((said(name, POSE, place), WedgeSensor(math.pi, 20.0, probability)))
        gossips.sort(key=lambda one: one[0].sender)
        words = table([gossip for gossip, _ in gossips], config=CONFIG, sensors=[sensor for _, sensor in gossips])
        assert [scan.sensor.probability(np.array([[20.0, 30.0]]), POSE)[0] for scan in words.scans()] == [0.5, 0.95]
        after.append(updated(backend, told, words, rectangle(60.0, 60.0)).updated.weights.tolist())
    assert after[0] == after[1]


@BOTH
def test_beyond_the_gate_a_detection_says_nothing_of_a_particle(backend: Backend) -> None:
    """6 standard deviations of 0.5 m."""
    for apart, is_near in ((2.99, True), (3.01, False)):
        words = table_of([said("s1", POSE, (20.0 + apart, 30.0))])
        found = updated(backend, particles((20.0, 30.0, 0.3)), words, rectangle(60.0, 60.0))
        unseen = 0.3 * (1.0 - 0.9) / (1.0 - 0.9 * 0.3)
        assert (found.updated.weights[0] != pytest.approx(unseen, rel=1e-12)) == is_near


def test_clutter_density_is_the_expected_clutter_over_the_area() -> None:
    sensor = SENSOR_CLASSES["A"]
    right = 0.1 / (math.radians(240.0) / 2.0 * 8.0**2)
    assert table([said("s1", POSE)], sensor).table[0, CLUTTER_DENSITY] == pytest.approx(right, rel=1e-12)
    words = table_of([said("s1", POSE, (12.0, 30.0))])
    right = 2.0 / (math.pi / 2.0 * 20.0**2)
    assert words.table[0, CLUTTER_DENSITY] == pytest.approx(right, rel=1e-12) and words.scans()[0].clutter_density == pytest.approx(
        right, rel=1e-12
    )


def test_an_id_that_is_told_and_copied_is_kept_once_as_it_was_told() -> None:
    told, copies = particles((1.0, 1.0, 0.1), (2.0, 2.0, 0.2), (3.0, 3.0, 0.3)), particles((9.0, 9.0, 0.9), (8.0, 8.0, 0.8))
    merged = united(told, np.array([True, False, True]), copies, np.array([True, True]))
    assert merged.ids.tolist() == [1, 2, 3] and merged.weights.tolist() == [0.1, 0.8, 0.3]
    twice = particles((1.0, 1.0, 0.1), (2.0, 2.0, 0.2))
    twice = unlabelled(twice.states, twice.weights, np.array([7, 7], dtype=np.uint64))
    assert united(twice, np.array([True, True]), NO_PARTICLES, np.array([], dtype=bool)).weights.tolist() == [0.1]


@pytest.mark.parametrize("name", ["s1", "s2", "s10"])
def test_a_claim_made_in_the_round_wins_the_ties_that_its_receivers_let_it_win(name: str) -> None:
    """s1 before s2 before s10; receivers go by the names."""
    words = table_of([said("s1", (10.0, 10.0, 0.0)), said("s2", (30.0, 10.0, 0.0)), said("s10", (20.0, 40.0, 0.0))])
    cell = cut(words.names.index(name), words.generators[:, :2], words.generators[:, 2], rectangle(60.0, 60.0))
    claim = claim_of(cell, words.names, words.generators)
    received = make_claim(claim.names, claim.generators)
    assert claim.names[0] == name and len(claim.names) == 3
    assert claim.wins_ties.tolist() == received.wins_ties.tolist() == [order(other) < order(name) for other in claim.names]


@BOTH
def test_a_point_on_a_border_belongs_to_the_first_name_alone(backend: Backend) -> None:
    generators = np.array([[10.0, 10.0, 0.0], [30.0, 10.0, 0.0]])
    first = make_claim(("s1", "s2"), generators)
    second = make_claim(("s2", "s1"), generators[::-1].copy())
    between = np.array([[20.0, 25.0, 0.0, 0.0]])
    assert [backend.orphaned(between, end_to_end([claim]), CONFIG.arena).tolist() for claim in (first, second)] == [[False], [True]]


@pytest.mark.parametrize(
    ("kind", "generator"), [("power", (7.0, 8.0, 3.0)), ("voronoi-cod", (7.0, 8.0, 0.0)), ("voronoi", (1.0, 2.0, 0.0))]
)
def test_the_generator_is_the_cod_and_the_power_radius_or_what_the_partition_makes_of_them(kind: str, generator: tuple[float, ...]) -> None:
    config = AgentConfig(partition=PartitionSettings(kind=kind))  # type: ignore[arg-type]
    gossip = Gossip(sender="s1", incarnation=1, tick=5, pose=(1.0, 2.0, 0.5), cod=(7.0, 8.0), power_radius=3.0, unused=30.0)
    assert table([gossip], SENSOR, config).generators.tolist() == [list(generator)]


def test_every_owner_draws_with_a_die_of_its_own_in_every_tick() -> None:
    offsets = {sample_offset(seed, owner, tick) for seed in (1, 2) for owner in ("s1", "s2") for tick in (5, 6)}
    assert len(offsets) == 8 and all(0.0 <= offset < 1.0 for offset in offsets)


@BOTH
def test_background_births_have_the_speed_of_all_particles(backend: Backend) -> None:
    config = AgentConfig(filter=FilterSettings(speed=1.5), birth=BirthSettings(background_particles=200, border_share=0.5))
    born = backend.background_births(Step(config, 5))
    assert len(born.ids) == 200
    assert np.hypot(born.states[:, 2], born.states[:, 3]) == pytest.approx(np.full(200, 1.5), rel=1e-12)


def test_measurement_births_are_spread_by_the_noise_in_east_and_north() -> None:
    """4000 copies: a standard error of 1.1 % of a standard deviation."""
    places = np.random.default_rng(1).random((400, 2)) * 60.0
    scan = Scan(random_key("sensor", "s1"), SENSOR, POSE, places, np.arange(400, dtype=np.uint64), 0.01)
    born = measurement_births(scan, np.full(400, 0.1), np.full(400, 9, np.uint64), Step(CONFIG, 5))
    offsets = born.states[:, :2] - np.repeat(places, CONFIG.birth.measurement_particles, axis=0)
    assert offsets.std(axis=0) == pytest.approx([0.5, 0.5], rel=0.05)
    assert abs(np.corrcoef(offsets.T)[0, 1]) < 0.08
