"""The compiled arithmetic: the loops of the kernels behind the signatures of the plain functions.

Importing this file imports numba. Sensors other than wedges are corrected by the plain functions.
"""

import math
from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from itertools import accumulate, pairwise

import numpy as np

from agents import (
    birth_kernels,
    cell_kernels,
    chorus_kernels,
    claim_kernels,
    extraction_kernels,
    gather_kernels,
    gossip_kernels,
    interest,
    interest_kernels,
    kernels,
    merge_kernels,
    phd,
    round_kernels,
    update_kernels,
)
from agents.arithmetic import Arithmetic, Parts, Refreshed, Task, in_steps, one_by_one
from agents.arithmetic import in_view as plain_in_view
from agents.arithmetic import update as plain_update
from agents.births import DIRECTIONS, inflow, sensor_row, starting_on_border
from agents.calm import Reader
from agents.cells import NO_CELL, TOUCH, Cell
from agents.claims import Claim, Claims
from agents.config import AgentConfig, ExtractionSettings
from agents.particles import NONE, Particles
from agents.step import Step
from agents.tiles import Rectangle
from agents.words import COLUMNS, Words
from protocol.sensing import Pose, SensorModel, WedgeSensor
from protocol.settings import ArenaSettings
from protocol.streams import key


def cut(index: int, points: np.ndarray, radii: np.ndarray, arena: np.ndarray) -> Cell:
    """See `cells.cut`."""
    corners, bounds = cell_kernels.cut(index, points, radii, arena, TOUCH)
    return Cell(corners, tuple(bounds.tolist())) if len(bounds) else NO_CELL


def cut_all(points: np.ndarray, radii: np.ndarray, arena: np.ndarray) -> list[Cell]:
    """See `cells.cut_all`."""
    corners, bounds, starts = cell_kernels.cut_all(points, radii, arena, TOUCH)
    indices, places = bounds.tolist(), starts.tolist()
    return [
        Cell(corners[first:last], tuple(indices[bound:end])) if end > bound else NO_CELL for (first, bound), (last, end) in pairwise(places)
    ]


def distances(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """See `geometry.distances`."""
    return cell_kernels.distances(polygon, points)  # type: ignore[no-any-return]


def owned(points: np.ndarray, claim: Claim, arena: ArenaSettings) -> np.ndarray:
    """See `claims.owned`."""
    return claim_kernels.owned(points, claim.generators, claim.first, arena.width, arena.height)  # type: ignore[no-any-return]


def unclaimed(points: np.ndarray, claims: Claims, arena: ArenaSettings) -> np.ndarray:
    """See `claims.unclaimed`."""
    return claim_kernels.unclaimed(points, *claims[1:], arena.width, arena.height)  # type: ignore[no-any-return]


def undisputed(points: np.ndarray, sizes: Sequence[int], claims: Claims, views: Sequence[int], overlap: float) -> np.ndarray:
    """See `claims.undisputed`."""
    return claim_kernels.undisputed(points, np.array(sizes), claims.generators, claims.ends, np.array(views), overlap)  # type: ignore[no-any-return]


Motion = tuple[np.uint64, np.uint64, np.uint64, float, float, float, float, float, bool, float, float]


def motion(step: Step) -> Motion:
    """A step of prediction as the kernels want it: three keys, dt, half the turn per deviation, speed, noise, survival, border, arena."""
    config, tick = step.config, step.tick
    run, settings, arena = config.run, config.filter, config.arena
    return (
        np.uint64(key(settings.seed, "turn", tick)),
        np.uint64(key(settings.seed, "east", tick)),
        np.uint64(key(settings.seed, "north", tick)),
        run.dt,
        0.5 * settings.heading_noise * math.sqrt(run.dt),
        settings.speed,
        settings.position_noise,
        phd.survival_probability(run.dt, settings),
        settings.border == "reflect",
        arena.width,
        arena.height,
    )


_BORN: deque[tuple[AgentConfig, int, Particles]] = deque(maxlen=2)


def births(step: Step) -> Particles:
    """See `births.background_births`; remembered, because in virtual time every agent asks."""
    config, tick = step
    for known, at, found in _BORN:
        if at == tick and known is config:
            return found
    birth, arena, mass = config.birth, config.arena, inflow(config.run.dt, config.filter, config.arena)
    count, salt = birth.background_particles, np.uint64(key(config.filter.seed, "background", tick))
    if not birth.background or mass <= 0.0:
        return NONE
    states, ids = birth_kernels.background(
        count, starting_on_border(config.filter, birth), salt, arena.width, arena.height, config.filter.speed, DIRECTIONS
    )
    _BORN.append((config, tick, Particles(states, np.full(count, mass / count), ids)))
    return births(step)


def predict(particles: Particles, step: Step) -> Particles:
    """See `arithmetic.predict`."""
    states, weights = kernels.predict(*particles, motion(step))
    return Particles(states, weights, particles.ids)


def outlying(near: Particles, told: Particles, polygon: np.ndarray, claim: Claim, horizon: float, step: Step) -> Particles:
    """See `arithmetic.outlying`."""
    cell, halo = polygon if len(polygon) else _NO_CORNERS, step.config.filter.halo
    return Particles(*merge_kernels.outlying(tuple(near), tuple(told), cell, claim.generators, claim.first, halo, horizon, motion(step)))


def unite(told: Particles, kept: np.ndarray, copies: Particles, free: np.ndarray) -> Particles:
    """See `arithmetic.unite`."""
    return Particles(*merge_kernels.unite(tuple(told), kept, tuple(copies), free))


def gather(
    particles: Particles, births: Particles, polygon: np.ndarray, eye: tuple[float, float], reach: float, step: Step
) -> tuple[Particles, Particles]:
    """See `arithmetic.gather`."""
    told, halo = tuple(particles), step.config.filter.halo
    found = gather_kernels.gather(_NOTHING_SAID, told, tuple(births), polygon, halo, eye, reach, step.reach, motion(step))
    return Particles(*found[:3]), Particles(*found[3:])


def update(particles: Particles, words: Words, polygon: np.ndarray, step: Step) -> Particles:
    """See `arithmetic.update`."""
    if not words.all_wedges:
        return plain_update(particles, words, polygon, step)
    config, birth, noise = step.config, step.config.birth, step.config.detection.noise
    births_key = np.uint64(key(config.filter.seed, "birth", step.tick))
    shape = (birth.measurement, birth.copies, birth.radius, birth.least_density, birth.least_share, birth.most_density)
    filters, width = config.filter, phd.likelihood_noise(noise, config.filter)
    return Particles(
        *update_kernels.update(
            *particles,
            words.table,
            words.salts,
            words.detections,
            polygon,
            filters.halo,
            (noise, width, (filters.gate * width) ** 2),
            (filters.certainty, filters.vicinity / phd.BINS),
            (*shape, filters.speed, births_key, DIRECTIONS),
        )
    )


def take(particles: Particles, claim: Claim, arena: ArenaSettings) -> Particles:
    """See `arithmetic.take`."""
    return Particles(*kernels.take(*particles, claim.generators, claim.first, arena.width, arena.height))


def resample(particles: Particles, owner: str, step: Step) -> Particles:
    """See `arithmetic.resample`."""
    mass = kernels.first_moments(particles.states, particles.weights)[0]
    if mass <= 0.0:
        return NONE
    seed = step.config.filter.seed
    count = phd.sample_size(mass, step.config.filter)
    offset = phd.sample_offset(seed, owner, step.tick)
    states, ids = kernels.resample(*particles, mass, count, offset, np.uint64(key(seed, "split", step.tick)))  # type: ignore[arg-type]
    return Particles(states, np.full(len(ids), mass / count), ids)


def estimate_targets(particles: Particles, settings: ExtractionSettings = ExtractionSettings()) -> np.ndarray:
    """See `extraction.estimate_targets`."""
    if not len(particles.weights):
        return np.empty((0, 2))
    return extraction_kernels.estimate_targets(particles.states, particles.weights, settings.bin, settings.threshold)  # type: ignore[no-any-return]


def moments(particles: Particles) -> tuple[float, float, float]:
    """See `arithmetic.moments`."""
    return kernels.first_moments(particles.states, particles.weights)  # type: ignore[no-any-return]


def in_view(particles: Particles, sensor: SensorModel, pose: Pose) -> tuple[float, float]:
    """See `arithmetic.in_view`."""
    if not isinstance(sensor, WedgeSensor):
        return plain_in_view(particles, sensor, pose)
    return kernels.in_view(particles.states, particles.weights, np.array(sensor_row(sensor, pose)))  # type: ignore[no-any-return]


_PREPARED: deque[tuple[AgentConfig, np.ndarray, np.ndarray]] = deque(maxlen=8)
_NO_CORNERS = np.empty((0, 2))  # not read-only, for the sake of one compilation
_NOTHING_SAID = np.empty((0, 4), np.float32), np.empty(0, np.uint64), np.empty((0, COLUMNS))


def prepared(config: AgentConfig) -> tuple[np.ndarray, np.ndarray]:
    """Settings and keys of a run in the order of `round_kernels`; computed once, because all agents of a simulation share them."""
    for known, settings, keys in _PREPARED:
        if known is config:
            return settings, keys
    filters, birth, noise = config.filter, config.birth, config.detection.noise
    step, width = Step(config, 0), phd.likelihood_noise(noise, filters)
    numbers = [*motion(step)[3:], filters.halo, step.reach, noise, width, (filters.gate * width) ** 2]
    numbers += [filters.certainty, filters.vicinity / phd.BINS]
    numbers += [birth.measurement, birth.copies, birth.radius, birth.least_density, birth.least_share, birth.most_density]
    numbers += [filters.particles_per_target, filters.least_particles, filters.most_particles]
    numbers += [config.extraction.bin, config.extraction.threshold]
    words = [key(config.filter.seed, word) for word in ("turn", "east", "north", "birth", "split")]
    _PREPARED.append((config, np.array(numbers, dtype=float), np.array(words, dtype=np.uint64)))
    return prepared(config)


def _box(states_bytes: bytes) -> bytes:
    return round_kernels.box(np.frombuffer(states_bytes, dtype=np.float32).reshape(-1, 4)).tobytes()  # type: ignore[no-any-return]


def said_near(words: Words, polygon: np.ndarray, task: Task) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, ids and rows of gossips: of all who hear the same together, else only of those who say something of what is near."""
    config = task.step.config
    if config.timing.interest == "all" or words.stands_ready:
        return *words.stated, words.table
    (x, y), reach = task.pose[:2], task.sensor.reach + task.step.reach
    near = round_kernels.touching(words.boxes(_box), polygon, config.filter.halo + task.step.reach, x, y, reach)
    return *words.stated_by(near.tolist()), words.table[near]


def refresh(task: Task) -> Refreshed:
    """See `arithmetic.in_steps`."""
    words, told, claim, config = task.words, task.told, task.claim, task.step.config
    if not words.all_wedges:
        return in_steps(FAST, task)
    settings, keys = prepared(config)
    polygon = task.polygon if len(task.polygon) else _NO_CORNERS
    said, others = (said_near(told, polygon, task), NONE) if isinstance(told, Words) else (_NOTHING_SAID, told)
    updated, own, kept, *rest = round_kernels.refresh(
        settings,
        keys,
        task.step.tick,
        words.names.index(task.owner),
        words.table,
        words.salts,
        words.detections,
        said,
        tuple(others),
        tuple(task.births),
        polygon,
        claim.generators,
        claim.first,
        np.uint64(key(config.filter.seed, "resample", task.owner)),
        DIRECTIONS,
    )
    return Refreshed(Particles(*updated), Particles(*own), Particles(*kept), *rest)


@lru_cache(maxsize=8)
def _draws(seed: int, names: tuple[str, ...]) -> np.ndarray:
    """Keys of the draws of some owners."""
    return np.array([key(seed, "resample", name) for name in names], dtype=np.uint64)


def refresh_all(words: Words, births: Particles, parts: Parts, step: Step) -> list[Refreshed]:
    """See `arithmetic.refresh_all`."""
    if not words.names or not words.all_wedges:
        return one_by_one(refresh, words, births, parts, step)
    settings, keys = prepared(step.config)
    polygons = [cell.polygon for cell in parts.cells]
    updated, own, kept, targets, sizes, sums = chorus_kernels.refresh_all(
        settings,
        keys,
        step.tick,
        words.table,
        words.salts,
        words.detections,
        words.stated,
        tuple(births),
        np.concatenate(polygons),
        _starts(polygons),
        np.concatenate([claim.generators for claim in parts.claims]),
        np.concatenate([claim.first for claim in parts.claims]),
        _starts([claim.first for claim in parts.claims]),
        _draws(step.config.filter.seed, words.names),
        DIRECTIONS,
    )
    found, starts = [], [0] * chorus_kernels.SIZES
    for ends, (mass, east, north, load, detected) in zip(np.cumsum(sizes, axis=0).tolist(), sums.tolist()):
        first, second, third = [_rows(*part) for part in zip((updated, own, kept), starts, ends)]
        found.append(Refreshed(first, second, third, mass, east, north, load, detected, targets[starts[3] : ends[3]]))
        starts = ends
    return found


def _rows(whole: tuple[np.ndarray, np.ndarray, np.ndarray], start: int, end: int) -> Particles:
    states, weights, ids = whole
    return Particles(states[start:end], weights[start:end], ids[start:end])


def _starts(arrays: list[np.ndarray]) -> np.ndarray:
    """Where each of some arrays begins when they lie end to end, and where the last one ends, (N + 1,)."""
    return np.array([0, *accumulate(map(len, arrays))])


_MARGINS = interest.MARGIN, interest.APPEARING, interest.SPACING, interest.THRESHOLD, interest.BEHIND


def wanted(
    cell: np.ndarray, eye: tuple[float, float], reach: float, halo: float, table: np.ndarray, ground: interest.Ground
) -> interest.Choice:
    """See `interest.wanted`."""
    home, bounds = cell if len(cell) else _NO_CORNERS, (ground.bounds.reach, ground.bounds.offset, ground.bounds.radius)
    chosen, needed = interest_kernels.wanted(home, eye, reach, halo, table, ground.arena, bounds, ground.drift, _MARGINS)
    return interest.Choice(chosen, Rectangle(*needed))


FAST = Arithmetic(
    cut=cut,
    cut_all=cut_all,
    distances=distances,
    owned=owned,
    unclaimed=unclaimed,
    undisputed=undisputed,
    outlying=outlying,
    unite=unite,
    births=births,
    predict=predict,
    gather=gather,
    update=update,
    take=take,
    resample=resample,
    estimate_targets=estimate_targets,
    moments=moments,
    in_view=in_view,
    refresh=refresh,
    refresh_all=refresh_all,
    wanted=wanted,
    reader=Reader(gossip_kernels.read, gossip_kernels.lay_out),
)
