"""What is worth seeing, who sees it, and where a sensor looks: the arithmetic of `search_and_track.SearchAndTrack`.

Data types: a `Task` is what one agent knows in a round; a `Memory` holds when it was all last seen; a `Decision` is the answer. Bins
are squares of side `search.bin` m, rows from south and columns from west. Mass in a bin that was in view lately is a *track*. Older
mass is to be *found*, and counts more. All lengths of the law are multiples of a bin, but for the way to a goal, and its times follow
`horizon` and `stale`.

Rules. All sums run one after the other, in the order of particles, bins and partners, and only exactly rounded operations occur:
agents/compiled/search_kernels.py computes the same bits. A sensor is taken for a circle, because it turns fast.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agents.config import SearchSettings
from agents.coverage.control import Intent, Surroundings
from agents.gossip.table import GossipTable
from agents.tracking.particles import Particles, mirrored, select, total
from protocol.arithmetic import exp_minus
from protocol.sensing import SensorModel, WedgeSensor

REACH_MARGIN = 0.75  # bins of the reach that a goal leaves for the motion of the targets
LEAST_RADIUS = 0.5  # of a circle, bins
LEAST_OFFSET = 0.05  # from a sensor to the place where a track is worth most, bins
DECAY_LENGTH = 3.0  # bins: the value of what lies outside of the circle falls with exp(-distance / `DECAY_LENGTH`)
PLAN_MARGIN = 7.5  # bins beyond the own circle that a plan looks at
PARTNER_MARGIN = 4.0  # bins beyond the circle of a partner that it serves
DECAY_LIMIT = 50.0  # such lengths away the value falls no further
OUTSIDE_VALUE = 0.4  # the value of a track just outside of the circle
NEVER_SEEN = -1.0e9  # s: the time of the last sight of what was never seen
NEW_PARTICLE_AGE = 0.5  # of `stale`: the greatest time out of sight of a particle that is new around the cell
SECTORS = 72  # of a full turn, among which a heading is chosen
HEADING_MARGIN = 0.2  # bins of the reach that the choice of a heading leaves for the motion of the targets
WINDOW_SHARE = 0.95  # of the viewing angle counts when a heading is chosen
VALUE_IN_VIEW = 0.05  # value of mass that is in view without a break
REGAIN_TIME = 0.1  # of `stale`: mass out of sight for this time has regained most of its value
UNSURE_MASSES = (0.05, 0.9)  # masses of a bin that may or may not be a target
FIRST_TURN = 0.9  # of the viewing angle, the turn of a sensor that has nothing to look at
CAPACITY_ANGLE = math.pi / 4.0  # rad: `search.capacity` is the number of targets that a sensor of this angle can hold
DIRECTIONS = np.array([(math.cos(math.pi * k / 8.0), math.sin(math.pi * k / 8.0)) for k in range(16)])
SECTOR_EDGES = np.array(
    [(math.cos(2.0 * math.pi * (k - 0.5) / SECTORS), math.sin(2.0 * math.pi * (k - 0.5) / SECTORS)) for k in range(SECTORS)]
)


class PlanInput(NamedTuple):
    """The numbers of a round, in the order of the columns of the kernels."""

    now: float  # s
    dt: float  # s until the next command
    x: float
    y: float
    cos: float  # of the heading
    sin: float
    reach: float  # m
    angle: float  # of view, rad; where the sensor is no wedge: 2 x area / reach^2, at most 2 pi
    offset: float  # m from the sensor to its COD
    width: float  # of the arena, m
    height: float
    speed: float  # m/s
    turn_rate: float  # rad/s
    is_open: float  # 1: targets cross the border, 0: they turn round there
    goal_x: float  # the own one, as the last gossip announced it
    goal_y: float


def service_radius(reach: float, side: float) -> float:
    """Radius in m of the circle that a sensor serves, by its reach and the side of a bin, both in m."""
    return max(reach - REACH_MARGIN * side, LEAST_RADIUS * side)


class Memory(NamedTuple):
    """When all was last in view, s of world time."""

    seen: np.ndarray  # of each bin of the arena (rows, columns)
    ids: np.ndarray  # of the particles around the cell, ascending
    last: np.ndarray  # of each of these


class Task(NamedTuple):
    """What one agent knows in a round."""

    numbers: PlanInput
    settings: SearchSettings
    sensor: SensorModel
    heading: float  # rad
    surroundings: Surroundings


class Decision(NamedTuple):
    """Where the body goes, and what the next gossip announces."""

    velocity: tuple[float, float]  # m/s
    turn_rate: float  # rad/s
    intent: Intent  # its utilisation is that of the tracks around the goal that was announced before
    memory: Memory


def no_memory(width: float, height: float, side: float) -> Memory:
    """The memory before the first round, of an arena of that size with bins of that side, m."""
    seen = np.full((math.ceil(height / side), math.ceil(width / side)), NEVER_SEEN)
    return Memory(seen, np.empty(0, dtype=np.uint64), np.empty(0))


def decide(task: Task, memory: Memory) -> Decision:
    """The decision of a round: choose a goal, move towards it, and turn to what is worth seeing from there."""
    numbers = task.numbers
    horizon = max(task.settings.horizon, numbers.dt)  # a command of a slower pace may last longer than the horizon
    seen = mark_view(memory.seen, task.surroundings.table, numbers.now, task.settings.bin)
    goal, utilisation = best_goal(task, seen)
    vx, vy = (goal[0] - numbers.x) / horizon, (goal[1] - numbers.y) / horizon
    around = select(task.surroundings.around, np.argsort(task.surroundings.around.ids, kind="stable"))
    last = last_sight(around, task, memory, seen)
    place = numbers.x + vx * numbers.dt, numbers.y + vy * numbers.dt
    turn = best_turn(task, place, around, last, unserved_particle_shares(task, around))
    return Decision((vx, vy), turn / numbers.dt, Intent(goal, utilisation), Memory(seen, around.ids, last))


def mark_view(seen: np.ndarray, table: GossipTable, now: float, side: float) -> np.ndarray:
    """The times of the last sight of all bins, after the scans of a tick: those with their centre in a field of view are seen `now`."""
    rows, columns = np.indices(seen.shape)
    centres, found = np.column_stack([(columns.ravel() + 0.5) * side, (rows.ravel() + 0.5) * side]), seen.copy()
    for sensor, pose in table.views:
        found.ravel()[sensor.probability(centres, pose) > 0.0] = now
    return found


def _seen_at(seen: np.ndarray, x: np.ndarray, y: np.ndarray, side: float) -> np.ndarray:
    """When the bins at some points were last in view, s (N,); `NEVER_SEEN` outside of the arena."""
    rows, columns = np.floor(y / side).astype(np.int64), np.floor(x / side).astype(np.int64)
    inside = (rows >= 0) & (columns >= 0) & (rows < seen.shape[0]) & (columns < seen.shape[1])
    found = np.full(len(x), NEVER_SEEN)
    found[inside] = seen[rows[inside], columns[inside]]
    return found


def bin_values(task: Task, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What each bin of the arena is worth (rows, columns) a horizon ahead: the mass of tracks, and the value of what is to be found.

    A particle is of a track if its bin was in view within `stale` s, or the place where it came from was. Targets enter at open borders.
    """
    numbers, settings, side = task.numbers, task.settings, task.settings.bin
    x, y, vx, vy = task.surroundings.density.states.T
    ahead, now, stale = settings.horizon + numbers.dt, numbers.now, settings.stale
    px, py = x + vx * ahead, y + vy * ahead
    if not numbers.is_open:
        px, py = mirrored(px, numbers.width)[0], mirrored(py, numbers.height)[0]
    last = _seen_at(seen, x, y, side)
    for before in (0.5 * stale, stale):
        last = np.where(now - last > stale, np.maximum(last, _seen_at(seen, x - vx * before, y - vy * before, side)), last)
    inside = (px >= 0.0) & (py >= 0.0) & (px <= numbers.width) & (py <= numbers.height)
    rows, columns = np.floor(py / side).astype(np.int64), np.floor(px / side).astype(np.int64)
    inside &= (rows < seen.shape[0]) & (columns < seen.shape[1])
    track = now - last <= stale
    flat = rows * seen.shape[1] + columns
    watched_mass, values = (
        np.bincount(flat[some], weights[some], seen.size).astype(float).reshape(seen.shape)
        for some, weights in (
            (inside & track, task.surroundings.density.weights),
            (inside & ~track, settings.weight * task.surroundings.density.weights),
        )
    )
    if numbers.is_open:
        border = np.ones(seen.shape, dtype=bool)
        border[1:-1, 1:-1] = False
        values[border] += settings.inflow
    return watched_mass, values


def _costs(apart: np.ndarray, radius: float) -> np.ndarray:
    """How far a sensor is from serving places at some distances, m: beyond its circle in m, inside as a share of the radius less 1."""
    return np.where(apart <= radius, apart / radius - 1.0, apart - radius)


def unserved_shares(task: Task, x: np.ndarray, y: np.ndarray, sharing: float) -> tuple[np.ndarray, np.ndarray]:
    """The shares at some places (N,) that partners with smaller cost leave to the own sensor: of tracks, and of what is to be found."""
    numbers, side = task.numbers, task.settings.bin
    dx, dy = x - numbers.goal_x, y - numbers.goal_y
    own = _costs(np.sqrt(dx * dx + dy * dy), service_radius(numbers.reach, side))
    tracks, values = np.ones(len(x)), np.ones(len(x))
    for goal_x, goal_y, utilisation, reach, first in task.surroundings.partners.tolist():
        radius = service_radius(reach, side)
        dx, dy = x - goal_x, y - goal_y
        apart = np.sqrt(dx * dx + dy * dy)
        cost = _costs(apart, radius)
        serves = (apart <= radius + PARTNER_MARGIN * side) & ((cost < own) | ((cost == own) & (first != 0.0)))
        inside, held = apart <= radius, min(1.0, 1.0 / max(utilisation, 1e-9))
        fade = np.where(inside, 1.0, exp_minus(np.minimum(np.maximum(apart - radius, 0.0) * (1.0 / (DECAY_LENGTH * side)), DECAY_LIMIT)))
        tracks = np.where(serves, tracks * (1.0 - sharing * held * np.where(inside, fade, OUTSIDE_VALUE * fade)), tracks)
        values = np.where(serves, values * (1.0 - sharing * fade), values)
    return tracks, values


def best_goal(task: Task, seen: np.ndarray) -> tuple[tuple[float, float], float]:
    """The goal in m, and the utilisation around the one that was announced: stay, or go one or half a horizon in one of 16 directions."""
    numbers, settings, side = task.numbers, task.settings, task.settings.bin
    radius = service_radius(numbers.reach, side)
    watched_mass, values = bin_values(task, seen)
    rows, columns = np.indices(seen.shape)
    x, y = (columns.ravel() + 0.5) * side, (rows.ravel() + 0.5) * side
    apart2 = (x - numbers.goal_x) * (x - numbers.goal_x) + (y - numbers.goal_y) * (y - numbers.goal_y)
    wide = radius + PLAN_MARGIN * side
    near = (watched_mass.ravel() + values.ravel() > 0.0) & (apart2 <= wide * wide)
    x, y, apart2 = x[near], y[near], apart2[near]
    track_shares, value_shares = unserved_shares(task, x, y, settings.sharing)
    track, value = watched_mass.ravel()[near] * track_shares, values.ravel()[near] * value_shares
    utilisation = total(np.where(apart2 <= radius * radius, track, 0.0))
    step, best, goal = 0.5 * settings.horizon * numbers.speed, -math.inf, (numbers.x, numbers.y)
    places = [(0.0, (1.0, 0.0)), *((distance, way) for way in DIRECTIONS.tolist() for distance in (2.0 * step, step))]
    for distance, (east, north) in places:
        place = min(max(numbers.x + distance * east, 0.0), numbers.width), min(max(numbers.y + distance * north, 0.0), numbers.height)
        dx, dy = place[0] - numbers.goal_x, place[1] - numbers.goal_y
        worth = worth_at(task, place, x, y, track, value)
        if step > 0.0:
            worth -= settings.step_cost * math.sqrt(dx * dx + dy * dy) / (2.0 * step)
        if worth > best:
            best, goal = worth, place
    held = settings.capacity * numbers.angle / CAPACITY_ANGLE
    return goal, utilisation / held if held > 0.0 else 0.0


def worth_at(task: Task, place: tuple[float, float], x: np.ndarray, y: np.ndarray, track: np.ndarray, value: np.ndarray) -> float:
    """What bins at x, y with a mass of tracks and a value of search (N,) are worth to the sensor at `place`.

    A track is worth most at the distance of the COD. A sensor on top of a target sees it come and go.
    """
    settings, side = task.settings, task.settings.bin
    radius = service_radius(task.numbers.reach, side)
    dx, dy = x - place[0], y - place[1]
    apart2 = dx * dx + dy * dy
    apart, best = np.sqrt(apart2), min(max(task.numbers.offset, LEAST_OFFSET * side), 0.9 * radius)
    away = (apart - best) * np.where(apart > best, 1.0 / (radius - best), 1.0 / best)
    inside = track * (1.0 - settings.falloff * away * away) + value
    outside = (OUTSIDE_VALUE * track + value) * exp_minus(
        np.minimum(np.maximum(apart - radius, 0.0) * (1.0 / (DECAY_LENGTH * side)), DECAY_LIMIT)
    )
    return total(np.where(apart2 <= radius * radius, inside, outside))


def last_sight(around: Particles, task: Task, memory: Memory, seen: np.ndarray) -> np.ndarray:
    """When each of the particles around the cell was last in view, s (N,). A new one counts as seen when its bin was, at most
    `NEW_PARTICLE_AGE` of `stale` ago."""
    now, settings, (x, y) = task.numbers.now, task.settings, around.states[:, :2].T
    last = np.maximum(_seen_at(seen, x, y, settings.bin), now - NEW_PARTICLE_AGE * settings.stale)
    if len(memory.ids):
        places = np.minimum(np.searchsorted(memory.ids, around.ids), len(memory.ids) - 1)
        last = np.where(memory.ids[places] == around.ids, memory.last[places], last)
    for sensor, pose in task.surroundings.table.views:
        last[sensor.probability(around.states[:, :2], pose) > 0.0] = now
    return last


def unserved_particle_shares(task: Task, around: Particles) -> np.ndarray:
    """The share of each particle that the sensor looks after (N,): what partners leave of its bin."""
    side = task.settings.bin
    x, y = np.floor(around.states[:, 0] / side), np.floor(around.states[:, 1] / side)
    return unserved_shares(task, (x + 0.5) * side, (y + 0.5) * side, 1.0)[0]


def best_turn(task: Task, place: tuple[float, float], around: Particles, last: np.ndarray, unserved: np.ndarray) -> float:
    """The turn in rad until the next command: to the heading whose window holds most. Of a wedge the best window a turn later counts
    in part."""
    numbers, width = task.numbers, 2.0 * math.pi / SECTORS
    if isinstance(task.sensor, WedgeSensor) and numbers.angle > 2.0 * math.pi - width:
        return 0.0
    most = min(numbers.turn_rate * numbers.dt, math.pi)
    points, worth = worth_around(task, place, around, last, unserved)
    if not (worth > 0.0).any():
        return min(most, FIRST_TURN * numbers.angle)
    reachable = min(math.floor(most / width), SECTORS // 2 - 1)
    order = sorted(range(-reachable, reachable + 1), key=lambda k: (abs(k), -k))
    if not isinstance(task.sensor, WedgeSensor):
        held = [total(task.sensor.probability(points, (*place, task.heading + k * width)) * worth) for k in order]
        return order[held.index(max(held))] * width
    dx, dy = points[:, 0] - place[0], points[:, 1] - place[1]
    sectors = sector_of(dx * numbers.cos + dy * numbers.sin, dy * numbers.cos - dx * numbers.sin)
    half = min(math.floor(0.5 * WINDOW_SHARE * numbers.angle / width), SECTORS // 2 - 1)
    values = window_values(np.bincount(sectors, worth, SECTORS), half, order, task.settings.second_heading)
    return order[values.index(max(values))] * width


def worth_around(
    task: Task, place: tuple[float, float], around: Particles, last: np.ndarray, unserved: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The particles within reach of `place` (N, 2) and what it is worth to see each of them now (N,).

    Mass out of view gains value with time. A bin that may hold no target is worth another look.
    """
    numbers, settings, x, y = task.numbers, task.settings, around.states[:, 0], around.states[:, 1]
    dx, dy, reach = x - place[0], y - place[1], max(numbers.reach - HEADING_MARGIN * settings.bin, 0.0)
    near = dx * dx + dy * dy <= reach * reach
    rows, columns = np.floor(y / settings.bin), np.floor(x / settings.bin)
    south, west = math.floor((place[1] - reach) / settings.bin), math.floor((place[0] - reach) / settings.bin)
    bins = int(2.0 * reach / settings.bin) + 2  # along a side of the box
    boxed = (rows >= south) & (columns >= west) & (rows < south + bins) & (columns < west + bins)
    flat = ((rows - south) * bins + columns - west)[boxed].astype(np.int64)
    masses = np.zeros(len(x))
    masses[boxed] = np.bincount(flat, around.weights[boxed], bins * bins).astype(float)[flat]
    age = (numbers.now - last + numbers.dt) / (REGAIN_TIME * settings.stale)
    value = VALUE_IN_VIEW + 1.0 - exp_minus(np.minimum(age * age, 18.0))
    unsure = (masses > UNSURE_MASSES[0]) & (masses < UNSURE_MASSES[1])
    value = np.where(unsure, value + settings.confirmation * (1.0 - masses), value)
    return around.states[near, :2], (around.weights * value * unserved)[near]


def sector_of(ahead: np.ndarray, left: np.ndarray) -> np.ndarray:
    """The sectors (N,) of directions in the frame of the sensor; sector 0 lies ahead, the others follow counter-clockwise."""
    behind = SECTOR_EDGES[0, 0] * left - SECTOR_EDGES[0, 1] * ahead < 0.0
    low = np.where(behind, SECTORS // 2, 0)
    high = low + SECTORS // 2
    while (high - low > 1).any():
        middle = (low + high) // 2
        beyond = SECTOR_EDGES[middle, 0] * left - SECTOR_EDGES[middle, 1] * ahead >= 0.0
        open_ = high - low > 1
        low, high = np.where(open_ & beyond, middle, low), np.where(open_ & ~beyond, middle, high)
    return low


def window_values(held: np.ndarray, half: int, order: Sequence[int], second_heading: float) -> list[float]:
    """What the window of 2 half + 1 sectors around each heading of `order` holds, and a share of the most that it can hold a turn later."""
    sums, most, found = [0.0], max(order), []
    for k in range(3 * SECTORS):
        sums.append(sums[-1] + float(held[k % SECTORS]))
    for k in range(SECTORS):  # a turn before, in front: a wide window and a wide turn reach so far
        sums.insert(0, sums[0] - float(held[-1 - k]))
    for k in order:
        low, high, then = 2 * SECTORS + k - half, 2 * SECTORS + k + half + 1, 0.0
        for shift in range(1, most + 1):
            new = min(shift, 2 * half + 1, SECTORS - 2 * half - 1)
            then = max(then, sums[high + shift] - sums[high + shift - new], sums[low - shift + new] - sums[low - shift])
        found.append(sums[high] - sums[low] + second_heading * then)
    return found
