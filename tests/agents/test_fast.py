"""The compiled arithmetic is the plain one to the last bit: every function of `Arithmetic`, on random and on empty inputs."""

import math
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import pytest
from agents.arithmetic import PLAIN, Arithmetic, Parts, Task
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agents.cells import NO_CELL
from agents.claims import end_to_end, make_claim
from agents.config import AgentConfig, BirthSettings, ExtractionSettings, FilterSettings, TimingSettings
from agents.interest import Ground
from agents.particles import NONE, Particles, join, select
from agents.step import Step
from agents.tiles import Bounds
from agents.words import Words, learn
from protocol.fields import pack
from protocol.geometry import EMPTY, rectangle
from protocol.messages import Gossip
from protocol.sensing import SENSOR_CLASSES, Pose
from protocol.settings import ArenaSettings, DetectionSettings, RunSettings
from protocol.streams import scramble

fast = pytest.importorskip("agents.fast")
FAST, said = fast.FAST, fast.said_near
SIDE = 40.0
ARENA, BOX = ArenaSettings(width=SIDE, height=SIDE), rectangle(SIDE, SIDE)
seeds = st.integers(0, 2**32 - 1)
some = settings(max_examples=60)


def bits(value: Any) -> Any:
    """A result as bytes and plain numbers, so that equal means equal in every bit."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes()
    if isinstance(value, tuple | list):
        return tuple(map(bits, value))
    return value.hex() if isinstance(value, float) else value


def assert_same(function: str, *arguments: Any) -> None:
    """Both arithmetics give the same bits."""
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
    return Particles(np.column_stack([places, rng.normal(0, 2, (count, 2))]), weights, ids)


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


def words(rng: np.random.Generator, particles: Particles, width: float = math.inf) -> Words:
    """Up to five scans of the paper's sensors, detections near particles and elsewhere; each says some of the particles, those in a strip
    of some width, m."""
    said = []
    for number in range(int(rng.integers(0, 6))):
        sensor = SENSOR_CLASSES["ABCDEFGH"[int(rng.integers(8))]]
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
        )
        learn(gossip, sensor, AgentConfig())
        said.append(gossip)
    return Words.of_gossips(said, bytearray().join([gossip.memo["row"] for gossip in said]))


def step(seed: int = 3, tick: int = 7, **filters: Any) -> Step:
    return Step(AgentConfig(run=RunSettings(dt=0.5), arena=ARENA, filter=FilterSettings(seed=seed, **filters)), tick)


def test_every_function_is_compared_here() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    others = [name for name in Arithmetic._fields if name != "reader"]  # that is what test_calm is about
    assert [name for name in others if f'assert_same("{name}"' not in text] == []


@given(seeds, st.integers(1, 14))
@some
def test_cut(seed: int, count: int) -> None:
    points, radii = diagram(np.random.default_rng(seed), count)
    for index in range(count):
        assert_same("cut", index, points, radii, BOX)
    assert_same("cut_all", points, radii, BOX)


@given(seeds, st.integers(1, 14), st.integers(0, 50))
@some
def test_owned(seed: int, count: int, places: int) -> None:
    rng = np.random.default_rng(seed)
    points, radii = diagram(rng, count)
    order = rng.permutation(count).tolist()
    claim = make_claim(tuple(map(str, order)), np.column_stack([points, radii])[order], tuple((number, "") for number in order))
    where = np.vstack([rng.random((places, 2)) * 44.0 - 2.0, np.round(rng.random((places, 2)) * SIDE)])
    assert_same("owned", where, claim, ARENA)
    assert_same("owned", np.column_stack([where, where]), make_claim((), np.empty((0, 3)), ()) if count == 1 else claim, ARENA)


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
        claims.append(make_claim(tuple(map(str, names)), table[names], tuple((name, "") for name in names)))
    where = np.vstack([rng.random((places, 4)) * 44.0 - 2.0, np.round(rng.random((places, 4)) * SIDE)])
    assert_same("unclaimed", where, end_to_end(claims), ARENA)
    sizes = rng.multinomial(len(where), [1.0 / count] * count)
    sizes = [int(size) if claim.names else 0 for size, claim in zip(sizes, claims)]
    views = rng.integers(-2, 2, count).tolist()
    for overlap in (0.0, 3.0):
        assert_same("undisputed", where[: sum(sizes)], sizes, end_to_end(claims), views, overlap)


@given(seeds, st.integers(1, 14), st.integers(0, 60), st.sampled_from([0.0, 5.0, math.inf]))
@some
def test_copies_after_a_round_and_what_counts_of_them(seed: int, count: int, number: int, horizon: float) -> None:
    rng = np.random.default_rng(seed)
    points, radii = diagram(rng, count)
    cell = PLAIN.cut(0, points, radii, BOX)
    names = cell.bounds
    claim = make_claim(tuple(map(str, names)), np.column_stack([points, radii])[list(names)], tuple((name, "") for name in names))
    near, told = cloud(rng, number), cloud(rng, int(rng.integers(0, 60)))
    mixed = join([told, select(near, rng.random(number) < 0.5)])
    for border in ("cross", "reflect"):
        for polygon in (cell.polygon, EMPTY):
            assert_same("outlying", near, mixed, polygon, claim, horizon, step(border=border))
    assert_same("unite", mixed, rng.random(len(mixed.ids)) < 0.8, near, rng.random(number) < 0.3)
    assert_same("unite", NONE, np.empty(0, dtype=bool), near, np.zeros(number, dtype=bool))


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
        assert fast.kernels.sort_by_id(ids, chosen.copy()).tolist() == wanted.tolist()


@given(seeds, st.integers(1, 10), st.integers(0, 50))
@some
def test_distances(seed: int, count: int, places: int) -> None:
    rng = np.random.default_rng(seed)
    points, radii = diagram(rng, count)
    where = rng.random((places, 4)) * 60.0 - 10.0
    assert_same("distances", PLAIN.cut(0, points, radii, BOX).polygon, where)
    assert_same("distances", EMPTY, where)


@given(seeds, st.integers(1, 200), st.floats(0.0, 1.0), st.booleans())
@some
def test_births(seed: int, count: int, share: float, wanted: bool) -> None:
    birth = BirthSettings(background_particles=count, border_share=share, background=wanted)
    run, filters, arena = RunSettings(dt=0.5), FilterSettings(seed=seed), ArenaSettings(width=SIDE, height=2.0 * SIDE)
    assert_same("births", Step(AgentConfig(run=run, filter=filters, arena=arena, birth=birth), seed % 1000))


@given(seeds, st.integers(0, 60), st.sampled_from(["cross", "reflect"]), st.floats(0.0, 2.0))
@some
def test_predict(seed: int, count: int, border: str, noise: float) -> None:
    motion = step(5, seed % 1000, border=border, heading_noise=noise, position_noise=noise / 3.0)
    assert_same("predict", cloud(np.random.default_rng(seed), count), motion)


@given(seeds, st.integers(0, 150), st.booleans(), st.sampled_from([0.1, 0.25, 1.0]))
@some
def test_update(seed: int, count: int, births: bool, noise: float) -> None:
    rng = np.random.default_rng(seed)
    particles = cloud(rng, count)
    config = AgentConfig(arena=ARENA, birth=BirthSettings(measurement=births), detection=DetectionSettings(noise=noise))
    assert_same("update", particles, words(rng, particles), BOX[[0, 1, 2]] * 0.5, Step(config, 7))


@given(seeds, st.integers(0, 4), st.integers(0, 40), st.integers(0, 20))
@some
def test_gather(seed: int, parts: int, count: int, births: int) -> None:
    """Several sets that share ids, as gossips and copies do."""
    rng = np.random.default_rng(seed)
    whole = cloud(rng, count)
    together = join([select(whole, rng.random(count) < 0.6) for _ in range(parts)])
    points, radii = diagram(rng, 5)
    polygon = PLAIN.cut(0, points, radii, BOX).polygon
    eye, reach = pose(rng)[:2], float(rng.random() * 20.0)
    assert_same("gather", together, cloud(rng, births), polygon, eye, reach, step())
    assert_same("gather", together, NONE, EMPTY, eye, reach, step(seed))


@given(seeds, st.integers(1, 8), st.integers(0, 60))
@some
def test_take(seed: int, count: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    points, radii = diagram(rng, count)
    claim = make_claim(tuple(map(str, range(count))), np.column_stack([points, radii]), tuple((number, "") for number in range(count)))
    particles = cloud(rng, size)
    shuffled = select(particles, rng.integers(0, size, size) if size else np.empty(0, dtype=int))
    assert_same("take", shuffled, claim, ARENA)
    assert_same("take", shuffled, make_claim((), np.empty((0, 3)), ()) if count == 1 else claim, ARENA)


@given(seeds, st.integers(0, 200), st.floats(0.0, 1.0))
@some
def test_resample(seed: int, count: int, weight: float) -> None:
    assert_same("resample", cloud(np.random.default_rng(seed), count, weight), "s12", step(3, seed % 1000))


@given(seeds, st.integers(0, 200), st.floats(0.0, 3.0), st.sampled_from([0.5, 1.0, 2.0]), st.sampled_from([0.1, 0.5, 0.9]), st.booleans())
@example(seed=1, count=20, weight=3.0, size=1.0, threshold=0.1, crowded=False)  # more targets than particles
@some
def test_estimate_targets(seed: int, count: int, weight: float, size: float, threshold: float, crowded: bool) -> None:
    particles = cloud(np.random.default_rng(seed), count, weight)
    if crowded:
        particles.states[:, :2] *= 0.1
    assert_same("estimate_targets", particles, ExtractionSettings(bin=size, threshold=threshold))


@given(seeds, st.integers(0, 200), st.sampled_from(sorted(SENSOR_CLASSES)))
@some
def test_moments_and_in_view(seed: int, count: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    particles = cloud(rng, count)
    assert_same("moments", particles)
    assert_same("in_view", particles, SENSOR_CLASSES[name], pose(rng))


def task(seed: int, size: int, count: int, kind: str, in_words: bool, interest: Literal["all", "neighbours"]) -> Task | None:
    """A round with particles from gossips or from elsewhere, with a cell ("power") or without one; None if nobody says anything."""
    rng = np.random.default_rng(seed)
    said = words(rng, cloud(rng, size), math.inf if interest == "all" else 6.0)
    if not said.names:
        return None
    points, radii = diagram(rng, count)
    cell = PLAIN.cut(0, points, radii, BOX) if kind == "power" else NO_CELL
    bounds = list(cell.bounds)
    claim = make_claim(tuple(map(str, bounds)), np.column_stack([points, radii])[bounds], tuple((number, "") for number in bounds))
    mine = said.gossips[int(rng.integers(len(said.gossips)))]
    told = said if in_words else cloud(rng, size, 0.3)
    born, now = cloud(rng, 12), step(3, seed % 1000)
    now = now._replace(config=msgspec.structs.replace(now.config, timing=TimingSettings(interest=interest)))
    return Task(mine.sender, mine.memo["sensor"], mine.pose, told, said, born, cell.polygon, claim, now)


@given(
    seeds,
    st.integers(0, 150),
    st.integers(1, 8),
    st.sampled_from(["power", "none"]),
    st.booleans(),
    st.sampled_from(["all", "neighbours"]),
)
@settings(max_examples=120)
def test_refresh(seed: int, size: int, count: int, kind: str, in_words: bool, interest: Literal["all", "neighbours"]) -> None:
    """All steps at once."""
    found = task(seed, size, count, kind, in_words, interest)
    if found is not None:
        assert_same("refresh", found)


@given(seeds, st.integers(0, 150), st.booleans())
@settings(max_examples=80)
def test_refresh_all(seed: int, size: int, wedges: bool) -> None:
    """All owners in one call: as each by itself."""
    rng = np.random.default_rng(seed)
    said = words(rng, cloud(rng, size), 12.0)
    points, radii = diagram(rng, max(1, len(said.names)))
    cells = PLAIN.cut_all(points, radii, BOX)[: len(said.names)]
    generators = np.column_stack([points, radii])
    claims = [
        make_claim(tuple(map(str, cell.bounds)), generators[list(cell.bounds)], tuple((number, "") for number in cell.bounds))
        for cell in cells
    ]
    if not wedges and said.gossips:
        said.gossips[0] = msgspec.structs.replace(said.gossips[0], scanned=True)
        for gossip, sensor in zip(said.gossips, [_Disc(), *[gossip.memo["sensor"] for gossip in said.gossips[1:]]]):
            learn(gossip, sensor, AgentConfig())
        said = Words.of_gossips(said.gossips, bytearray().join([gossip.memo["row"] for gossip in said.gossips]))
    now = step(3, seed % 1000)
    now = now._replace(config=msgspec.structs.replace(now.config, timing=TimingSettings(interest="all")))
    assert_same("refresh_all", said, cloud(rng, 12), Parts(cells, claims), now)


class _Disc:
    """A sensor that is no wedge."""

    reach, area = 9.0, 81.0 * math.pi

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        return np.where((points[:, 0] - pose[0]) ** 2 + (points[:, 1] - pose[1]) ** 2 <= 81.0, 0.8, 0.0)

    def footprint(self, pose: Pose) -> np.ndarray:
        return EMPTY


def test_who_hears_a_part_reads_no_gossip_of_what_is_far() -> None:
    found = [task(seed, 150, 8, "power", True, "neighbours") for seed in range(40)]
    read = [len(said(one.told, one.polygon, one)[2]) for one in found if one is not None and isinstance(one.told, Words)]
    assert 0 < sum(read) < 0.9 * sum(len(one.words.names) for one in found if one is not None)


def test_nothing_at_all() -> None:
    assert_same("predict", NONE, step())
    assert_same("gather", NONE, NONE, BOX, (0.0, 0.0), 5.0, step())
    assert_same("update", NONE, Words.of_gossips([], bytearray()), BOX, step())
    assert_same("update", NONE, Words.of_gossips([], bytearray()), EMPTY, step())
    assert_same("take", NONE, make_claim((), np.empty((0, 3)), ()), ARENA)
    assert_same("resample", NONE, "s1", step())
    assert_same("estimate_targets", NONE)
    assert_same("moments", NONE)
    assert_same("in_view", NONE, SENSOR_CLASSES["A"], (0.0, 0.0, 0.0))
    assert_same("distances", BOX, np.empty((0, 2)))


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
    cell = PLAIN.cut(others, points, radii, rectangle(side, side)).polygon
    for arithmetic in (PLAIN, FAST):
        ground = Ground(rectangle(side, side), Bounds(25.0, 7.0, 20.0), 5.0, arithmetic.distances)
        x, y, reach = places[-1].tolist()
        assert_same("wanted", cell, (x, y), reach, 6.0, table, ground)
