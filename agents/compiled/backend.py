"""The compiled backend: the loops of the kernels behind the signatures of the plain functions.

Data types: `FAST` is the `Backend` (agents/backend.py) of these functions.

Rules. Importing this file imports numba. The plain functions compute the regions in reach of a sensor that is not a wedge.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import msgspec
import numpy as np

from agents.backend import Backend
from agents.compiled import (
    birth_kernels,
    cell_kernels,
    claim_kernels,
    copy_kernels,
    region_kernels,
    run_columns,
    search_kernels,
    selection_kernels,
)
from agents.config import AgentConfig
from agents.coverage import search_plan
from agents.coverage.cells import NO_CELL, Cell
from agents.coverage.control import Intent
from agents.gossip.table import COLUMNS, KIND, OTHER, REACH, GossipTable
from agents.interest import selection
from agents.interest.tiles import Rectangle
from agents.tracking import phd, regions
from agents.tracking.births import inflow, starting_on_border, survival_probability
from agents.tracking.claims import Claim, Claims
from agents.tracking.extraction import TargetEstimates
from agents.tracking.measurement_likelihood import kernel_variance
from agents.tracking.particles import NO_PARTICLES, Particles, unlabelled
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput, RegionUpdate
from protocol import geometry
from protocol.compact_particles import DIRECTIONS
from protocol.random_streams import random_key
from protocol.sensing import WedgeSensor
from protocol.settings import ArenaSettings


def cut_cells(indices: Sequence[int], generators: np.ndarray, arena: np.ndarray) -> list[Cell]:
    """See `cells.cut_cells`."""
    points, radii = generators[:, :2].copy(), generators[:, 2].copy()
    corners, bounds, starts = cell_kernels.cut_cells(np.array(indices, dtype=np.int64), points, radii, arena)
    chosen, places = bounds.tolist(), starts.tolist()
    return [
        Cell(corners[first:last], tuple(chosen[bound:end])) if end > bound else NO_CELL for (first, bound), (last, end) in pairwise(places)
    ]


def resolve_conflicts(points: np.ndarray, sizes: Sequence[int], claims: Claims, hashes: Sequence[int], overlap: float) -> np.ndarray:
    """See `claims.resolve_conflicts`."""
    ends, stated = claims.ends, np.array(hashes)
    return claim_kernels.resolve_conflicts(points, np.array(sizes), claims.generators, ends, stated, overlap)  # type: ignore[no-any-return]


def orphaned(points: np.ndarray, claims: Claims, arena: ArenaSettings) -> np.ndarray:
    """See `claims.orphaned`."""
    return claim_kernels.orphaned(points, *claims[1:], arena.width, arena.height)  # type: ignore[no-any-return]


@lru_cache(maxsize=8)
def background_births(step: Step) -> Particles:
    """See `births.background_births`."""
    config, tick = step
    birth, arena, mass = config.birth, config.arena, inflow(config.run.dt, config.filter, config.arena)
    count, salt = birth.background_particles, np.uint64(random_key(config.filter.seed, "background", tick))
    if not birth.background or mass <= 0.0:
        return NO_PARTICLES
    on_border = starting_on_border(config.filter, birth)
    states, ids = birth_kernels.background(count, on_border, salt, arena.width, arena.height, config.filter.speed, DIRECTIONS)
    return unlabelled(states, np.full(count, mass / count), ids)


def remote_copies(near: Particles, density: Particles, polygon: np.ndarray, claim: Claim, copy_distance: float, step: Step) -> Particles:
    """See `regions.remote_copies`."""
    cell, run = polygon if len(polygon) else _NO_CORNERS, (*prepared(step.config), step.tick)
    return Particles(*copy_kernels.remote_copies(tuple(near), tuple(density), cell, claim.generators, claim.wins_ties, copy_distance, *run))


_NO_CORNERS = np.empty((0, 2))  # writable, because a read-only array would need a second compilation
_NOTHING_STATED = np.empty((0, 4), np.float32), np.empty(0, np.uint64), np.empty(0, np.uint64), np.empty((0, COLUMNS))


@lru_cache(maxsize=8)
def prepared(config: AgentConfig) -> tuple[np.ndarray, np.ndarray]:
    """Settings and keys of a run, in the columns of agents/compiled/run_columns.py; a pure memo: a simulation has one of both."""
    filters, birth, noise = config.filter, config.birth, config.detection.noise
    step, width = Step(config, 0), phd.likelihood_noise(noise, filters)
    settings = {
        run_columns.DT: config.run.dt,
        run_columns.HALF_TURN: 0.5 * filters.heading_noise * math.sqrt(config.run.dt),
        run_columns.SPEED: filters.speed,
        run_columns.POSITION_NOISE: filters.position_noise,
        run_columns.SURVIVAL: survival_probability(config.run.dt, filters),
        run_columns.REFLECT: filters.border == "reflect",
        run_columns.WIDTH: config.arena.width,
        run_columns.HEIGHT: config.arena.height,
        run_columns.HALO: filters.halo,
        run_columns.STEP: step.max_displacement,
        run_columns.NOISE: noise,
        run_columns.LIKELIHOOD_NOISE: width,
        run_columns.GATE2: (filters.gate * width) ** 2,
        run_columns.CERTAINTY: filters.certainty,
        run_columns.MISS_BIN: filters.vicinity / phd.BINS_IN_VICINITY,
        run_columns.BIRTHS: birth.measurement,
        run_columns.BIRTHS_PER_DETECTION: birth.measurement_particles,
        run_columns.BIRTH_RADIUS: birth.radius,
        run_columns.LEAST_DENSITY: birth.least_density,
        run_columns.LEAST_SHARE: birth.least_share,
        run_columns.MOST_DENSITY: birth.most_density,
        run_columns.PER_TARGET: filters.particles_per_target,
        run_columns.LEAST: filters.least_particles,
        run_columns.MOST: filters.most_particles,
        run_columns.BIN: config.extraction.bin,
        run_columns.THRESHOLD: config.extraction.threshold,
        run_columns.BESIDE: config.extraction.beside,
        run_columns.GATE: filters.gate,
        run_columns.KERNEL: kernel_variance(filters),
    }
    purposes = {
        run_columns.TURN: "turn",
        run_columns.EASTWARD: "east",
        run_columns.NORTHWARD: "north",
        run_columns.BIRTH: "birth",
        run_columns.SPLIT: "split",
    }
    keys = [random_key(filters.seed, purposes[column]) for column in range(len(purposes))]
    return np.array([settings[column] for column in range(len(settings))], dtype=float), np.array(keys, dtype=np.uint64)


def update_regions(
    table: GossipTable, density: GossipTable | Particles, births: Particles, regions_: Sequence[RegionInput], step: Step
) -> list[RegionUpdate]:
    """See `regions.update_regions`."""
    wedges = [type(region.sensor) is WedgeSensor for region in regions_]
    if table.all_wedges and len(table.table) and False not in wedges:
        return _update_wedges(table, density, births, regions_, step)
    return _update_mixed(table, density, births, regions_, step)


def _update_mixed(
    table: GossipTable, density: GossipTable | Particles, births: Particles, regions_: Sequence[RegionInput], step: Step
) -> list[RegionUpdate]:
    """The updates of a team with other sensors than wedges; compiled loops compute the regions out of reach of those sensors."""
    others, halo = table.table[table.table[:, KIND] == OTHER], step.config.filter.halo
    found = []
    for region in regions_:
        reached = bool((geometry.distances(region.polygon, others) <= halo + others[:, REACH]).any())
        is_plain = reached or type(region.sensor) is not WedgeSensor or not len(table.table)
        found += (regions.update_regions if is_plain else _update_wedges)(table, density, births, [region], step)
    return found


def _update_wedges(
    table: GossipTable, density: GossipTable | Particles, births: Particles, regions_: Sequence[RegionInput], step: Step
) -> list[RegionUpdate]:
    """The updates of a team of wedges, by one call of the compiled loops."""
    if not regions_:
        return []
    config = step.config
    settings, keys = prepared(config)
    stated: tuple[np.ndarray, ...]
    stated, others = _NOTHING_STATED, NO_PARTICLES
    if isinstance(density, GossipTable):
        stated = *density.stated, density.table
    else:
        others = density
    updated, own, drawn, estimates, names, results = region_kernels.update_regions(
        settings,
        keys,
        step.tick,
        table.table,
        table.salts,
        table.detections,
        table.rays,
        stated,
        tuple(others),
        tuple(births),
        np.array([(region.row, len(region.polygon), len(region.claim.wins_ties)) for region in regions_]),
        np.concatenate([region.polygon for region in regions_]),
        np.concatenate([region.claim.generators for region in regions_]),
        np.concatenate([region.claim.wins_ties for region in regions_]),
        _draws(config.filter.seed, tuple([region.owner for region in regions_])),
        DIRECTIONS,
    )
    found, start = [], [0] * region_kernels.SIZES
    for result in results.tolist():
        end = [begin + int(size) for begin, size in zip(start, result)]
        near, mine, new = [_rows(*part) for part in zip((updated, own, drawn), start, end)]
        rows = slice(start[3], end[3])
        mass, moment_x, moment_y, load, detected = result[region_kernels.SIZES :]
        targets = TargetEstimates(estimates[rows, :2].copy(), estimates[rows, 2:].copy(), names[rows])
        found.append(RegionUpdate(near, mine, new, mass, moment_x, moment_y, load, detected, targets))
        start = end
    return found


@lru_cache(maxsize=1024)
def _draws(seed: int, names: tuple[str, ...]) -> np.ndarray:
    """Keys of the resampling of each owner (K,), a pure memo of the last 1024 groups."""
    return np.array([random_key(seed, "resample", name) for name in names], dtype=np.uint64)


def _rows(whole: tuple[np.ndarray, ...], start: int, end: int) -> Particles:
    """The particles from `start` to `end`."""
    states, weights, ids, labels = whole
    return Particles(states[start:end], weights[start:end], ids[start:end], labels[start:end])


def select_peers(
    cell: np.ndarray, position: tuple[float, float], reach: float, halo: float, table: np.ndarray, ground: selection.KnownArena
) -> selection.Selection:
    """See `selection.select_peers`."""
    home, bounds = cell if len(cell) else _NO_CORNERS, (ground.bounds.reach, ground.bounds.offset, ground.bounds.radius)
    chosen, needed = selection_kernels.select_peers(home, position, reach, halo, table, ground.arena, bounds, ground.drift)
    return selection.Selection(chosen, Rectangle(*needed))


def decide(task: search_plan.Task, memory: search_plan.Memory) -> search_plan.Decision:
    """See `search_plan.decide`."""
    density, around, table, partners, *_ = task.surroundings
    if not table.all_wedges or type(task.sensor) is not WedgeSensor:
        return search_plan.decide(task, memory)
    settings = np.array(msgspec.structs.astuple(task.settings), dtype=float)
    points = density.states, density.weights, tuple(around)
    answer = search_kernels.decide(np.array(task.numbers), settings, *points, table.table, partners, tuple(memory), *_UNIT_VECTORS)
    vx, vy, turn_rate, goal_x, goal_y, utilisation = [float(number) for number in answer[:6]]  # loops run as plain Python give numpy's
    return search_plan.Decision((vx, vy), turn_rate, Intent((goal_x, goal_y), utilisation), search_plan.Memory(*answer[6]))


_UNIT_VECTORS = search_plan.DIRECTIONS, search_plan.SECTOR_EDGES


FAST = Backend(
    cut_cells=cut_cells,
    background_births=background_births,
    update_regions=update_regions,
    resolve_conflicts=resolve_conflicts,
    orphaned=orphaned,
    remote_copies=remote_copies,
    select_peers=select_peers,
    decide=decide,
)
