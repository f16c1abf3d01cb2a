"""The compiled backend is the plain one to the last bit: every function of `Backend`, on random and on empty inputs."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agents.backend import PLAIN, Backend
from agents.config import AgentConfig, BirthSettings, ExtractionSettings, FilterSettings, TimingSettings
from agents.coverage.cells import NO_CELL, Cell, cut
from agents.gossip.table import GossipTable
from agents.interest.selection import KnownArena
from agents.interest.tiles import Bounds
from agents.tracking.claims import end_to_end, make_claim, owned
from agents.tracking.extraction import NO_ESTIMATES, estimate_targets
from agents.tracking.particles import NO_PARTICLES, Particles, join, mirrored, select, total
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput
from protocol.fields import pack, pack_labels
from protocol.gaussian_components import MOST_OWN_MASS
from protocol.geometry import EMPTY, rectangle
from protocol.messages import Gossip
from protocol.random_streams import scramble
from protocol.sensing import SENSOR_CLASSES, Pose, WedgeSensor
from protocol.settings import ArenaSettings, DetectionSettings, RunSettings
from tests.agents.gossip_table import table as table_of

fast = pytest.importorskip("agents.compiled.backend")
from agents.compiled import claim_kernels, extraction_kernels  # noqa: E402
from agents.compiled import particle_kernels as kernels  # noqa: E402
from agents.compiled.cache import is_switched_off  # noqa: E402
from agents.compiled.label_kernels import stamp_of  # noqa: E402

FAST = fast.FAST
SIDE = 40.0
ARENA, BOX = ArenaSettings(width=SIDE, height=SIDE), rectangle(SIDE, SIDE)
seeds = st.integers(0, 2**32 - 1)
some = settings(max_examples=40)
SENSORS = (*SENSOR_CLASSES.values(), WedgeSensor(math.radians(200.0), 12.0, 0.9, None, 0.1))  # the last sees less far away


def bits(value: Any) -> Any:
    """A result as bytes and plain numbers, so that equal means equal in every bit."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes()
    if isinstance(value, tuple | list):
        return tuple(map(bits, value))
    return value.hex() if isinstance(value, float) else value


def assert_same(function: str, *arguments: Any) -> None:
    """Both backends give the same bits."""
    plain, fast = getattr(PLAIN, function)(*arguments), getattr(FAST, function)(*arguments)
    assert bits(plain) == bits(fast), f"{function}: {plain} != {fast}"


def cloud(rng: np.random.Generator, count: int, weight: float = 0.1) -> Particles:
    """Particles in clumps and at random, some outside the arena, some without mass."""
    centres = rng.random((3, 2)) * SIDE
    places = np.where(
        rng.random((count, 1)) < 0.5, centres[rng.integers(0, 3, count)] + rng.normal(0, 0.5, (count, 2)), rng.random((count, 2)) * 44 - 2
    )
    weights = rng.random(count) * weight * (rng.random(count) < 0.95)
    ids = np.sort(scramble(np.arange(count, dtype=np.uint64), int(rng.integers(2**60))))
    labels = rng.integers(0, 6, count).astype(np.uint64)
    return Particles(np.column_stack([places, rng.normal(0, 2, (count, 2))]), weights, ids, labels)


def pose(rng: np.random.Generator) -> Pose:
    """Anywhere in the arena."""
    x, y, turn = rng.random(3).tolist()
    return x * SIDE, y * SIDE, (turn - 0.5) * 2.0 * math.pi


def diagram(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Generators, some of them coincident, some on whole metres, some outside; radii, some of them equal."""
    points = rng.random((count, 2)) * 50.0 - 5.0
    points = np.where(rng.random((count, 1)) < 0.5, np.round(points), points)
    points[rng.random(count) < 0.3] = points[0]
    radii = np.where(rng.random(count) < 0.4, 8.0, rng.random(count) * 25.0)
    return points, radii


def words(rng: np.random.Generator, particles: Particles, width: float = math.inf) -> GossipTable:
    """Up to five scans of `SENSORS`, detections near particles and elsewhere; each says some of the particles, those in a strip
    of some width, m."""
    said, sensors = [], []
    for number in range(int(rng.integers(0, 6))):
        sensor = SENSORS[int(rng.integers(len(SENSORS)))]
        count = int(rng.integers(0, 6))
        detections = rng.random((count, 2)) * SIDE
        if count and len(particles.ids):
            detections[0] = particles.states[int(rng.integers(len(particles.ids))), :2] + 0.1
        middle = float(rng.random()) * SIDE
        in_strip = np.abs(particles.states[:, 0] - middle) <= 0.5 * width
        posed, held = pose(rng), select(particles, (rng.random(len(particles.ids)) < 0.3) & in_strip)
        gossip = Gossip(
            sender=f"s{number}",
            incarnation=1,
            tick=7,
            pose=posed,
            cod=posed[:2],
            power_radius=0.0,
            unused=0.0,
            detections_bytes=pack(np.clip(detections, 0.0, SIDE), "<f4"),
            scanned=bool(rng.random() < 0.9),
            weight=float(rng.random()) * 0.1,
            states_bytes=pack(held.states, "<f4"),
            ids_bytes=pack(held.ids, "<u8"),
            labels_bytes=pack_labels(held.labels)[0],
            label_numbers_bytes=pack_labels(held.labels)[1],
        )
        said.append(gossip)
        sensors.append(sensor)
    return table_of(said, sensors=sensors)


def step(seed: int = 3, tick: int = 7, **filters: Any) -> Step:
    return Step(AgentConfig(run=RunSettings(dt=0.5), arena=ARENA, filter=FilterSettings(seed=seed, **filters)), tick)


def test_every_function_is_compared_here() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    others = [name for name in Backend._fields if name != "decide"]  # tests/swarm/test_search_and_track.py compares whole runs
    assert [name for name in others if f'assert_same("{name}"' not in text] == []


def test_a_backend_has_at_most_eight_functions_and_that_of_the_search() -> None:
    assert len(Backend._fields) <= 9


@given(seeds, st.integers(1, 14))
@some
def test_cut_cells(seed: int, count: int) -> None:
    points, radii = diagram(np.random.default_rng(seed), count)
    for indices in (range(count), [count - 1], [], [0, 0]):
        assert_same("cut_cells", indices, np.column_stack([points, radii]), BOX)


@given(seeds, st.integers(1, 14), st.integers(0, 50))
@some
def test_owned(seed: int, count: int, places: int) -> None:
    """Which points a claim holds, the claim of nobody too."""
    rng = np.random.default_rng(seed)
    points, radii = diagram(rng, count)
    order = rng.permutation(count).tolist()
    where = np.vstack([rng.random((places, 2)) * 44.0 - 2.0, np.round(rng.random((places, 2)) * SIDE)])
    for names in (order, []):
        claim = make_claim(tuple(map(str, names)), np.column_stack([points, radii])[names])
        compiled = claim_kernels.owned(where, claim.generators, claim.wins_ties, SIDE, SIDE)
        assert bits(owned(where, claim, ARENA)) == bits(compiled)


@given(seeds, st.integers(1, 14), st.integers(0, 50))
@some
def test_what_claims_together_leave_and_dispute(seed: int, count: int, places: int) -> None:
    """Claims of several diagrams, of which each owner knows a part, and none of some."""
    rng = np.random.default_rng(seed)
    points, radii = diagram(rng, count)
    table, claims = np.column_stack([points, radii]), []
    for owner in range(count):
        others = [other for other in rng.permutation(count).tolist() if other != owner and rng.random() < 0.7]
        names = [owner, *others] if rng.random() < 0.9 else []
        claims.append(make_claim(tuple(map(str, names)), table[names]))
    where = np.vstack([rng.random((places, 4)) * 44.0 - 2.0, np.round(rng.random((places, 4)) * SIDE)])
    assert_same("orphaned", where, end_to_end(claims), ARENA)
    sizes = rng.multinomial(len(where), [1.0 / count] * count)
    sizes = [int(size) if claim.names else 0 for size, claim in zip(sizes, claims)]
    views = rng.integers(-2, 2, count).tolist()
    for overlap in (0.0, 3.0):
        assert_same("resolve_conflicts", where[: sum(sizes)], sizes, end_to_end(claims), views, overlap)


@given(seeds, st.integers(1, 14), st.integers(0, 60), st.sampled_from([0.0, 5.0, math.inf]))
@some
def test_copies_after_a_round_and_what_counts_of_them(seed: int, count: int, number: int, horizon: float) -> None:
    rng = np.random.default_rng(seed)
    points, radii = diagram(rng, count)
    cell = cut(0, points, radii, BOX)
    names = cell.bounding
    claim = make_claim(tuple(map(str, names)), np.column_stack([points, radii])[list(names)])
    near, told = cloud(rng, number), cloud(rng, int(rng.integers(0, 60)))
    mixed = join([told, select(near, rng.random(number) < 0.5)])
    for border in ("cross", "reflect"):
        for polygon in (cell.polygon, EMPTY):
            assert_same("remote_copies", near, mixed, polygon, claim, horizon, step(border=border))


@given(seeds, st.integers(0, 300), st.sampled_from(["hashes", "few", "numbers", "ends"]))
@some
def test_ids_are_sorted_whether_or_not_they_are_hashes(seed: int, count: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    ids = scramble(np.arange(count, dtype=np.uint64), int(rng.integers(2**60)))
    if kind == "few":
        ids = ids[rng.integers(0, max(1, count // 4), count)]
    elif kind == "numbers":
        ids = rng.integers(0, 1 + count, count).astype(np.uint64)
    elif kind == "ends":
        ids = np.where(rng.random(count) < 0.5, np.uint64(0), np.uint64(2**64 - 1))
    for chosen in (rng.permutation(count), np.argsort(ids, kind="stable")):
        wanted = chosen[np.argsort(ids[chosen], kind="stable")]
        assert kernels.sort_by_id(ids, chosen.copy()).tolist() == wanted.tolist()


@given(seeds, st.floats(0.5, 50.0))
@some
def test_what_lies_beyond_a_border_is_mirrored_until_it_lies_in_the_arena(seed: int, length: float) -> None:
    places = np.random.default_rng(seed).normal(0.0, 60.0, 50)
    inside, turned = mirrored(places, length)
    assert (inside >= 0.0).all() and (inside <= length).all()
    assert np.cos(inside * math.pi / length) == pytest.approx(np.cos(places * math.pi / length))
    for place, mirror, turns in zip(places.tolist(), inside.tolist(), turned.tolist()):
        assert kernels.mirrored_one(place, 1.0, length) == (mirror, -1.0 if turns else 1.0)


@given(seeds, st.integers(1, 200), st.floats(0.0, 1.0), st.booleans())
@some
def test_births(seed: int, count: int, share: float, wanted: bool) -> None:
    birth = BirthSettings(background_particles=count, border_share=share, background=wanted)
    run, filters, arena = RunSettings(dt=0.5), FilterSettings(seed=seed), ArenaSettings(width=SIDE, height=2.0 * SIDE)
    assert_same("background_births", Step(AgentConfig(run=run, filter=filters, arena=arena, birth=birth), seed % 1000))


@given(seeds, st.integers(0, 200), st.floats(0.0, 3.0), st.sampled_from([0.5, 1.0, 2.0]), st.sampled_from([0.1, 0.5, 0.9]), st.booleans())
@example(seed=1, count=20, weight=3.0, size=1.0, threshold=0.1, crowded=False)  # more targets than particles
@some
def test_estimate_targets(seed: int, count: int, weight: float, size: float, threshold: float, crowded: bool) -> None:
    particles = cloud(np.random.default_rng(seed), count, weight)
    if crowded:
        particles.states[:, :2] *= 0.1
    for beside in (0.0, 1.5 * threshold):
        plain = estimate_targets(particles, ExtractionSettings(bin=size, threshold=threshold, beside=beside), tick=7)
        if not count:
            assert bits(plain) == bits(NO_ESTIMATES)
            continue
        states, weights, _, labels = particles
        stamp = np.uint64(stamp_of(np.uint64(7)))  # a Python number is another signature: everything would be compiled again
        found, names = extraction_kernels.estimate_targets(states, weights, labels, size, threshold, beside, stamp)
        assert bits(plain) == bits((found[:, :2], found[:, 2:], names))


class Case(NamedTuple):
    """The arguments of `update_regions`."""

    table: GossipTable
    density: GossipTable | Particles
    births: Particles
    regions: list[RegionInput]
    step: Step


def settings_of(rng: np.random.Generator, tick: int, interest: str) -> Step:
    """Settings of every kind that a region's update reads."""
    noise, turn = float(rng.choice([0.1, 0.25, 1.0])), float(rng.random())
    border: Any = str(rng.choice(["cross", "reflect"]))
    config = AgentConfig(
        run=RunSettings(dt=0.5),
        arena=ARENA,
        filter=FilterSettings(seed=3, border=border, heading_noise=turn, position_noise=turn / 3.0),
        birth=BirthSettings(measurement=bool(rng.random() < 0.7)),
        detection=DetectionSettings(noise=noise),
        extraction=ExtractionSettings(bin=float(rng.choice([0.5, 1.0, 2.0])), threshold=float(rng.choice([0.1, 0.5, 0.9]))),
        timing=TimingSettings(interest=interest),  # type: ignore[arg-type]
    )
    return Step(config, tick)


def regions_of(rng: np.random.Generator, table: GossipTable, owners: int) -> list[RegionInput]:
    """Cells and claims of some of those who speak, some of them empty."""
    points, radii = diagram(rng, max(owners, int(rng.integers(1, 9))))
    generators, found = np.column_stack([points, radii]), []
    for place in rng.permutation(len(table.names))[:owners].tolist():
        cell = cut(place % len(radii), points, radii, BOX) if rng.random() < 0.9 else NO_CELL
        claim = make_claim(tuple(map(str, cell.bounding)), generators[list(cell.bounding)])
        gossip = table.gossips[place]
        found.append(RegionInput(gossip.sender, place, table.sensors[place].sensor, gossip.pose, cell.polygon, claim))
    return found


def case(seed: int, size: int, owners: int, in_table: bool, interest: str, others: int = 0) -> Case:
    """A round of some owners with particles from gossips or from elsewhere; so many sensors are no wedges."""
    rng = np.random.default_rng(seed)
    whole, now = cloud(rng, size), settings_of(rng, seed % 1000, interest)
    if now.config.filter.border == "reflect":  # nothing is ever outside, from where it could be mirrored far inwards
        np.clip(whole.states[:, :2], 0.0, SIDE, out=whole.states[:, :2])
    table = words(rng, whole, 12.0 if interest == "all" else 6.0)
    carried = [_Disc() if place < others else each.sensor for place, each in enumerate(table.sensors)]
    table = table_of(table.gossips, sensors=carried)
    shared = join([select(whole, rng.random(size) < 0.6) for _ in range(int(rng.integers(1, 4)))])  # ids twice, as after a merge
    born, regions = cloud(rng, 12), regions_of(rng, table, owners)
    return Case(table, table if in_table else shared, born, regions, now)


@given(seeds, st.integers(0, 150), st.integers(0, 5), st.booleans(), st.sampled_from(["all", "neighbours"]), st.integers(0, 2))
@example(seed=1, size=150, owners=2, in_table=True, interest="all", others=0)  # a sensor whose probability falls sees much of what counts
@settings(max_examples=100)
def test_update_regions(seed: int, size: int, owners: int, in_table: bool, interest: str, others: int) -> None:
    """All steps at once, of no owner, of one and of several, with sensors of both kinds."""
    assert_same("update_regions", *case(seed, size, owners, in_table, interest, others))


def test_an_owner_of_more_targets_than_a_gossip_may_state_states_fewer() -> None:
    """A gossip of more than 1000 is refused, and its sender would be silent for all."""
    crowd = case(0, 150, 1, in_table=False, interest="all")
    heavy = crowd._replace(density=crowd.density._replace(weights=np.full(len(crowd.density.ids), 10.0)))  # type: ignore[union-attr]
    assert_same("update_regions", *heavy)
    (update,) = FAST.update_regions(*heavy)
    weights = update.resampled.weights
    assert total(update.own.weights) > 1000.0 and total(weights) == pytest.approx(MOST_OWN_MASS) and len(weights) * weights[0] <= 1000.0


@given(seeds, st.integers(0, 150), st.booleans())
@some
def test_what_is_computed_for_several_owners_is_what_each_computes_alone(seed: int, size: int, in_table: bool) -> None:
    together = case(seed, size, 5, in_table, "all")
    alone = [FAST.update_regions(*together._replace(regions=[region]))[0] for region in together.regions]
    assert bits(FAST.update_regions(*together)) == bits(alone)


class _Disc:
    """A sensor that is no wedge."""

    reach, area = 9.0, 81.0 * math.pi

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        return np.where((points[:, 0] - pose[0]) ** 2 + (points[:, 1] - pose[1]) ** 2 <= 81.0, 0.8, 0.0)

    def footprint(self, pose: Pose) -> np.ndarray:
        return EMPTY


def test_regions_that_only_wedges_look_at_are_computed_by_the_compiled_loops_in_a_mixed_team(monkeypatch: pytest.MonkeyPatch) -> None:
    """The disc sees 9 m far from 5 m east, and the halo is 6 m: of the cells, which begin at 0, 17.5 and 34 m, it reaches two."""
    compiled, calls = fast.region_kernels.update_regions, []
    monkeypatch.setattr(fast.region_kernels, "update_regions", lambda *given: calls.append(1) or compiled(*given))
    said = [
        Gossip(sender=f"s{n}", incarnation=1, tick=7, pose=(x, 20.0, 0.0), cod=(x, 20.0), power_radius=0.0, unused=0.0)
        for n, x in enumerate((5.0, 30.0, 38.0))
    ]
    table = table_of(said, sensors=(_Disc(), SENSOR_CLASSES["A"], SENSOR_CLASSES["C"]))
    generators = np.array([[5.0, 20.0, 0.0], [30.0, 20.0, 0.0], [38.0, 20.0, 0.0]])
    regions = []
    for place, cell in enumerate(cells_of(generators)):
        bounds = list(cell.bounding)
        claim = make_claim(tuple(map(str, bounds)), generators[bounds])
        regions.append(RegionInput(f"s{place}", place, table.sensors[place].sensor, said[place].pose, cell.polygon, claim))
    assert_same("update_regions", table, cloud(np.random.default_rng(1), 100), NO_PARTICLES, regions, step())
    assert len(calls) == 1


@pytest.mark.skipif(is_switched_off(), reason="as plain Python the loops take minutes")
def test_a_thousand_detections_of_one_place_are_named_in_a_moment() -> None:
    """Each finds a target with a label and 12 particles of its own. In time that grows with their cube it would be minutes."""
    count, place = 1000, (20.0, 20.0)
    labels = np.repeat(np.arange(count, dtype=np.uint64) * 2 + 1, 12) | stamp_of(np.uint64(7))
    states, ids = np.tile([*place, 0.0, 0.0], (12 * count, 1)), np.arange(12 * count, dtype=np.uint64) + 1
    said = Gossip(
        sender="s0",
        incarnation=1,
        tick=7,
        pose=(15.0, 20.0, 0.0),
        cod=place,
        power_radius=0.0,
        unused=0.0,
        detections_bytes=pack(np.tile(place, (count, 1)), "<f4"),
    )
    table = table_of([said])
    region = RegionInput("s0", 0, table.sensors[0].sensor, said.pose, BOX, make_claim(("0",), np.array([[*place, 0.0]])))
    cloud = Particles(states, np.full(12 * count, 1.0 / 12.0), ids, labels)
    named = FAST.update_regions(table, cloud, NO_PARTICLES, [region], step())[0].estimates.labels
    assert len(named) == len(set(named.tolist())) == count


def cells_of(generators: np.ndarray) -> list[Cell]:
    return PLAIN.cut_cells(range(len(generators)), generators, BOX)


def test_nothing_at_all() -> None:
    nobody = table_of([])
    for polygon in (BOX, EMPTY):
        region = RegionInput("s1", 0, SENSOR_CLASSES["A"], (0.0, 0.0, 0.0), polygon, make_claim((), np.empty((0, 3))))
        assert_same("update_regions", nobody, NO_PARTICLES, NO_PARTICLES, [region], step())
    assert_same("update_regions", nobody, NO_PARTICLES, NO_PARTICLES, [], step())


@given(seeds, st.integers(0, 90))
@some
def test_whom_to_hear(seed: int, others: int) -> None:
    """Every choice and the needed ground, with a cell, without one, and in a corner of a large arena."""
    rng = np.random.default_rng(seed)
    side = float(rng.choice([SIDE, 200.0]))
    points, radii = diagram(rng, others + 1)
    points *= rng.random() * side / SIDE + 0.2
    places = np.column_stack([points + rng.normal(0.0, 5.0, points.shape), rng.choice([5.0, 8.0, 25.0], others + 1)])
    table = np.column_stack([places, points, radii])
    cell = cut(others, points, radii, rectangle(side, side)).polygon
    ground = KnownArena(rectangle(side, side), Bounds(25.0, 7.0, 20.0), 5.0)
    x, y, reach = places[-1].tolist()
    assert_same("select_peers", cell, (x, y), reach, 6.0, table, ground)
