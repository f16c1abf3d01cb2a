"""Compiled search-and-track: the bit-for-bit twins of the functions of agents/coverage/search_plan.py.

Data types: bins are squares of `side` m, rows from south and columns from west. A sensor is a row of `GossipTable.table`. Partners
are rows (x, y, utilisation, reach, 1 where the name comes first). The settings are in the columns `BIN` to `CAPACITY`.

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.compiled.particle_kernels import exp_minus, mirrored_one, sort_by_id, wedge_probability
from agents.coverage.search_plan import (
    CAPACITY_ANGLE,
    DECAY_LENGTH,
    DECAY_LIMIT,
    FIRST_TURN,
    HEADING_MARGIN,
    LEAST_OFFSET,
    NEVER_SEEN,
    NEW_PARTICLE_AGE,
    OUTSIDE_VALUE,
    PARTNER_MARGIN,
    PLAN_MARGIN,
    REGAIN_TIME,
    SECTORS,
    UNSURE_MASSES,
    VALUE_IN_VIEW,
    WINDOW_SHARE,
    service_radius,
)
from agents.gossip.table import COS as SENSOR_COS
from agents.gossip.table import COS_HALF, KIND, WEDGE
from agents.gossip.table import REACH as SENSOR_REACH
from agents.gossip.table import SIN as SENSOR_SIN
from agents.gossip.table import X as SENSOR_X
from agents.gossip.table import Y as SENSOR_Y

# Columns of the settings (`config.SearchSettings`) and of the numbers of a round (`search_plan.PlanInput`)
BIN, HORIZON, STALE, WEIGHT, INFLOW, CONFIRMATION, SHARING, FALLOFF, SECOND_HEADING, STEP_COST, CAPACITY = range(11)
NOW, DT, X, Y, COS, SIN, REACH, ANGLE, OFFSET, WIDTH, HEIGHT, SPEED, TURN_RATE, OPEN, GOAL_X, GOAL_Y = range(16)
GOAL_EAST, GOAL_NORTH, UTILISATION, PARTNER_REACH, FIRST = range(5)  # columns of a partner


_service_radius = njit(service_radius)


@njit
def _mark_view(seen: np.ndarray, table: np.ndarray, now: float, side: float) -> None:
    """Twin of `search_plan.mark_view`, in place."""
    rows, columns = seen.shape
    for k in range(len(table)):
        if table[k, KIND] != WEDGE:
            continue
        x, y, reach = table[k, SENSOR_X], table[k, SENSOR_Y], table[k, SENSOR_REACH]
        cos, sin, cos_half = table[k, SENSOR_COS], table[k, SENSOR_SIN], table[k, COS_HALF]
        west, east = max(int(np.floor((x - reach) / side)), 0), min(int(np.floor((x + reach) / side)), columns - 1)
        south, north = max(int(np.floor((y - reach) / side)), 0), min(int(np.floor((y + reach) / side)), rows - 1)
        for row in range(south, north + 1):
            for column in range(west, east + 1):
                dx, dy = (column + 0.5) * side - x, (row + 0.5) * side - y
                if wedge_probability(dx, dy, cos, sin, reach, cos_half, 1.0, 1.0) > 0.0:
                    seen[row, column] = now


@njit
def _seen_at(seen: np.ndarray, x: float, y: float, side: float) -> float:
    """Twin of `search_plan._seen_at` for one point."""
    row, column = int(np.floor(y / side)), int(np.floor(x / side))
    if row < 0 or column < 0 or row >= seen.shape[0] or column >= seen.shape[1]:
        return NEVER_SEEN
    return seen[row, column]


@njit
def _bin_values(
    states: np.ndarray, weights: np.ndarray, seen: np.ndarray, numbers: np.ndarray, search: np.ndarray, box: tuple[int, int, int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Twin of `search_plan.bin_values` for the bins of a box: first and last row, first and last column."""
    south, north, west, east = box
    watched_mass, search_values = np.zeros((north - south + 1, east - west + 1)), np.zeros((north - south + 1, east - west + 1))
    ahead, stale, now, width, height = search[HORIZON] + numbers[DT], search[STALE], numbers[NOW], numbers[WIDTH], numbers[HEIGHT]
    side = search[BIN]
    for n in range(len(weights)):
        x, y, vx, vy = states[n, 0], states[n, 1], states[n, 2], states[n, 3]
        px, py = x + vx * ahead, y + vy * ahead
        if numbers[OPEN] == 0.0:
            px, py = mirrored_one(px, vx, width)[0], mirrored_one(py, vy, height)[0]
        row, column = int(np.floor(py / side)), int(np.floor(px / side))
        if row < south or row > north or column < west or column > east or px > width or py > height:
            continue
        last = _seen_at(seen, x, y, side)
        half = 0.5 * stale
        if now - last > stale:
            last = max(last, _seen_at(seen, x - vx * half, y - vy * half, side))
        if now - last > stale:
            last = max(last, _seen_at(seen, x - vx * stale, y - vy * stale, side))
        if now - last <= stale:
            watched_mass[row - south, column - west] += weights[n]
        else:
            search_values[row - south, column - west] += search[WEIGHT] * weights[n]
    if numbers[OPEN] != 0.0:
        rows, columns = seen.shape
        for row in range(south, north + 1):
            for column in range(west, east + 1):
                if row == 0 or column == 0 or row == rows - 1 or column == columns - 1:
                    search_values[row - south, column - west] += search[INFLOW]
    return watched_mass, search_values


@njit
def _cost(apart: float, radius: float) -> float:
    """Twin of `search_plan._costs`."""
    return apart / radius - 1.0 if apart <= radius else apart - radius


@njit
def _partners_near(partners: np.ndarray, x: float, y: float, width: float, side: float) -> np.ndarray:
    """The rows of partners that may serve a place within `width` m of a point."""
    near, number = np.empty(len(partners), np.int64), 0
    for k in range(len(partners)):
        dx, dy = partners[k, GOAL_EAST] - x, partners[k, GOAL_NORTH] - y
        near[number] = k
        number += math.sqrt(dx * dx + dy * dy) <= width + _service_radius(partners[k, PARTNER_REACH], side) + PARTNER_MARGIN * side + 1e-6
    return near[:number]


@njit
def _unserved_shares(
    x: float, y: float, numbers: np.ndarray, partners: np.ndarray, near: np.ndarray, sharing: float, side: float
) -> tuple[float, float]:
    """Twin of `search_plan.unserved_shares` for one place; `near` are the rows of partners that may serve it."""
    dx, dy, radius = x - numbers[GOAL_X], y - numbers[GOAL_Y], _service_radius(numbers[REACH], side)
    own, tracks, values = _cost(math.sqrt(dx * dx + dy * dy), radius), 1.0, 1.0
    for i in range(len(near)):
        k = near[i]
        other = _service_radius(partners[k, PARTNER_REACH], side)
        dx, dy = x - partners[k, GOAL_EAST], y - partners[k, GOAL_NORTH]
        apart = math.sqrt(dx * dx + dy * dy)
        if apart > other + PARTNER_MARGIN * side:
            continue
        cost = _cost(apart, other)
        if cost < own or (cost == own and partners[k, FIRST] != 0.0):
            fade = 1.0 if apart <= other else exp_minus(min((apart - other) * (1.0 / (DECAY_LENGTH * side)), DECAY_LIMIT))
            held = min(1.0, 1.0 / max(partners[k, UTILISATION], 1e-9))
            tracks *= 1.0 - sharing * held * (fade if apart <= other else OUTSIDE_VALUE * fade)
            values *= 1.0 - sharing * fade
    return tracks, values


@njit
def _worth_at(
    x: float,
    y: float,
    xs: np.ndarray,
    ys: np.ndarray,
    tracks: np.ndarray,
    values: np.ndarray,
    radius: float,
    best: float,
    falloff: float,
    decay: float,
    terms: np.ndarray,
) -> None:
    """The terms of `search_plan.worth_at`, without branches."""
    beyond, within, rate, radius2 = 1.0 / (radius - best), 1.0 / best, 1.0 / decay, radius * radius
    for n in range(len(xs)):
        dx, dy = xs[n] - x, ys[n] - y
        apart2 = dx * dx + dy * dy
        apart = math.sqrt(apart2)
        away = (apart - best) * (beyond if apart > best else within)
        inside = tracks[n] * (1.0 - falloff * away * away) + values[n]
        outside = (OUTSIDE_VALUE * tracks[n] + values[n]) * exp_minus(min(max(apart - radius, 0.0) * rate, DECAY_LIMIT))
        terms[n] = inside if apart2 <= radius2 else outside


@njit
def _best_goal(
    numbers: np.ndarray,
    search: np.ndarray,
    states: np.ndarray,
    weights: np.ndarray,
    seen: np.ndarray,
    partners: np.ndarray,
    directions: np.ndarray,
) -> tuple[float, float, float]:
    """Twin of `search_plan.best_goal`: x, y in m, and the utilisation around the goal that was announced."""
    rows, columns = seen.shape
    gx, gy = numbers[GOAL_X], numbers[GOAL_Y]
    side = search[BIN]
    radius = _service_radius(numbers[REACH], side)
    wide = radius + PLAN_MARGIN * side
    low, left = min(max(int(np.floor((gy - wide) / side)), 0), rows), min(max(int(np.floor((gx - wide) / side)), 0), columns)
    high, right = min(int(np.floor((gy + wide) / side)), rows - 1), min(int(np.floor((gx + wide) / side)), columns - 1)
    box = low, max(high, low - 1), left, max(right, left - 1)  # empty where the sensor is far from the arena
    watched_mass, values = _bin_values(states, weights, seen, numbers, search, box)
    near = _partners_near(partners, gx, gy, wide, side)
    size = watched_mass.size
    xs, ys, ts, ds, count, utilisation = np.empty(size), np.empty(size), np.empty(size), np.empty(size), 0, 0.0
    for row in range(watched_mass.shape[0]):
        y = (box[0] + row + 0.5) * side
        for column in range(watched_mass.shape[1]):
            if watched_mass[row, column] + values[row, column] <= 0.0:
                continue
            x = (box[2] + column + 0.5) * side
            apart2 = (x - gx) * (x - gx) + (y - gy) * (y - gy)
            if apart2 > wide * wide:
                continue
            track_share, value_share = _unserved_shares(x, y, numbers, partners, near, search[SHARING], side)
            track, value = watched_mass[row, column] * track_share, values[row, column] * value_share
            if apart2 <= radius * radius:
                utilisation += track
            xs[count], ys[count], ts[count], ds[count] = x, y, track, value
            count += 1
    x, y = numbers[X], numbers[Y]
    step = search[HORIZON] * numbers[SPEED] * 0.5
    best_at = min(max(numbers[OFFSET], LEAST_OFFSET * side), 0.9 * radius)
    best, best_x, best_y, terms = -np.inf, x, y, np.empty(count)
    for candidate in range(2 * len(directions) + 1):
        far = 0.0 if candidate == 0 else 2.0 * step if candidate % 2 else step
        d = (candidate - 1) // 2
        qx = min(max(x + far * directions[d, 0], 0.0), numbers[WIDTH])
        qy = min(max(y + far * directions[d, 1], 0.0), numbers[HEIGHT])
        _worth_at(qx, qy, xs[:count], ys[:count], ts[:count], ds[:count], radius, best_at, search[FALLOFF], DECAY_LENGTH * side, terms)
        total = 0.0
        for n in range(count):
            total += terms[n]
        if step > 0.0:
            total -= search[STEP_COST] * math.sqrt((qx - gx) * (qx - gx) + (qy - gy) * (qy - gy)) / (2.0 * step)
        if total > best:
            best, best_x, best_y = total, qx, qy
    held = search[CAPACITY] * numbers[ANGLE] / CAPACITY_ANGLE
    return best_x, best_y, utilisation / held if held > 0.0 else 0.0


@njit
def _last_sight(
    states: np.ndarray,
    ids: np.ndarray,
    old_ids: np.ndarray,
    old_last: np.ndarray,
    table: np.ndarray,
    seen: np.ndarray,
    now: float,
    search: np.ndarray,
) -> np.ndarray:
    """Twin of `search_plan.last_sight`."""
    last, old = np.empty(len(ids)), 0
    side, unknown = search[BIN], NEW_PARTICLE_AGE * search[STALE]
    for n in range(len(ids)):
        while old < len(old_ids) and old_ids[old] < ids[n]:
            old += 1
        if old < len(old_ids) and old_ids[old] == ids[n]:
            last[n] = old_last[old]
        else:
            last[n] = max(_seen_at(seen, states[n, 0], states[n, 1], side), now - unknown)
    west, east, south, north = np.inf, -np.inf, np.inf, -np.inf
    for n in range(len(ids)):
        west, east = min(west, states[n, 0]), max(east, states[n, 0])
        south, north = min(south, states[n, 1]), max(north, states[n, 1])
    for k in range(len(table)):
        x, y, reach = table[k, SENSOR_X], table[k, SENSOR_Y], table[k, SENSOR_REACH]
        if table[k, KIND] != WEDGE or x + reach < west or x - reach > east or y + reach < south or y - reach > north:
            continue
        cos, sin, cos_half = table[k, SENSOR_COS], table[k, SENSOR_SIN], table[k, COS_HALF]
        for n in range(len(ids)):
            if wedge_probability(states[n, 0] - x, states[n, 1] - y, cos, sin, reach, cos_half, 1.0, 1.0) > 0.0:
                last[n] = now
    return last


@njit
def _sector(ahead: float, left: float, edges: np.ndarray) -> int:
    """Twin of `search_plan.sector_of` for one direction; `edges` are unit vectors at the start of each sector."""
    low, high = 0, SECTORS // 2
    if edges[0, 0] * left - edges[0, 1] * ahead < 0.0:
        low, high = SECTORS // 2, SECTORS
    while high - low > 1:
        middle = (low + high) // 2
        if edges[middle, 0] * left - edges[middle, 1] * ahead >= 0.0:
            low = middle
        else:
            high = middle
    return low


@njit
def _best_turn(
    numbers: np.ndarray,
    search: np.ndarray,
    x: float,
    y: float,
    states: np.ndarray,
    weights: np.ndarray,
    last: np.ndarray,
    unserved: np.ndarray,
    edges: np.ndarray,
) -> float:
    """Twin of `search_plan.best_turn` for a wedge at x, y."""
    side, forgotten = search[BIN], REGAIN_TIME * search[STALE]
    now, reach = numbers[NOW], max(numbers[REACH] - HEADING_MARGIN * side, 0.0)
    held, any_worth = np.zeros(SECTORS), False
    west, south = int(np.floor((x - reach) / side)), int(np.floor((y - reach) / side))
    bins = int(2.0 * reach / side) + 2  # along a side of the box
    masses = np.zeros((bins, bins))
    for n in range(len(weights)):
        row, column = int(np.floor(states[n, 1] / side)) - south, int(np.floor(states[n, 0] / side)) - west
        if row >= 0 and column >= 0 and row < bins and column < bins:
            masses[row, column] += weights[n]
    for n in range(len(weights)):
        dx, dy = states[n, 0] - x, states[n, 1] - y
        if dx * dx + dy * dy > reach * reach:
            continue
        age = (now - last[n] + numbers[DT]) / forgotten
        value = VALUE_IN_VIEW + 1.0 - exp_minus(min(age * age, 18.0))
        mass = masses[int(np.floor(states[n, 1] / side)) - south, int(np.floor(states[n, 0] / side)) - west]
        if UNSURE_MASSES[0] < mass and mass < UNSURE_MASSES[1]:
            value += search[CONFIRMATION] * (1.0 - mass)
        worth = weights[n] * value * unserved[n]
        held[_sector(dx * numbers[COS] + dy * numbers[SIN], dy * numbers[COS] - dx * numbers[SIN], edges)] += worth
        any_worth = any_worth or worth > 0.0
    most = min(numbers[TURN_RATE] * numbers[DT], math.pi)
    width = 2.0 * math.pi / SECTORS
    if numbers[ANGLE] > 2.0 * math.pi - width:
        return 0.0
    if not any_worth:
        return min(most, FIRST_TURN * numbers[ANGLE])
    half = min(int(np.floor(0.5 * WINDOW_SHARE * numbers[ANGLE] / width)), SECTORS // 2 - 1)
    reachable = min(int(np.floor(most / width)), SECTORS // 2 - 1)
    sums = np.zeros(4 * SECTORS + 1)
    for k in range(3 * SECTORS):
        sums[SECTORS + k + 1] = sums[SECTORS + k] + held[k % SECTORS]
    for k in range(SECTORS):  # a turn before, in front: a wide window and a wide turn reach so far
        sums[SECTORS - 1 - k] = sums[SECTORS - k] - held[SECTORS - 1 - k]
    best, choice = -np.inf, 0
    for order in range(2 * reachable + 1):
        k = (order + 1) // 2 if order % 2 else -(order // 2)
        low, high = 2 * SECTORS + k - half, 2 * SECTORS + k + half + 1
        here, then = sums[high] - sums[low], 0.0
        for shift in range(1, reachable + 1):
            new = min(shift, 2 * half + 1, SECTORS - 2 * half - 1)
            then = max(then, sums[high + shift] - sums[high + shift - new], sums[low - shift + new] - sums[low - shift])
        value = here + search[SECOND_HEADING] * then
        if value > best:
            best, choice = value, k
    return choice * width


@njit
def _unserved_particle_shares(numbers: np.ndarray, x: float, y: float, states: np.ndarray, partners: np.ndarray, side: float) -> np.ndarray:
    """Twin of `search_plan.unserved_particle_shares` for the particles within reach of x, y; each bin is computed once."""
    reach = numbers[REACH]
    near = _partners_near(partners, x, y, reach + 2.0 * side, side)
    west, south, bins = int(np.floor((x - reach) / side)) - 1, int(np.floor((y - reach) / side)) - 1, int(2.0 * reach / side) + 4
    unserved, found = np.full((bins, bins), -1.0), np.zeros(len(states))
    for n in range(len(states)):
        row, column = int(np.floor(states[n, 1] / side)) - south, int(np.floor(states[n, 0] / side)) - west
        if row < 0 or column < 0 or row >= bins or column >= bins:
            continue
        if unserved[row, column] < 0.0:
            centre_x, centre_y = (column + west + 0.5) * side, (row + south + 0.5) * side
            unserved[row, column] = _unserved_shares(centre_x, centre_y, numbers, partners, near, 1.0, side)[0]
        found[n] = unserved[row, column]
    return found


@cached
def decide(
    numbers: np.ndarray,
    search: np.ndarray,
    states: np.ndarray,
    weights: np.ndarray,
    around: tuple,
    table: np.ndarray,
    partners: np.ndarray,
    memory: tuple,
    directions: np.ndarray,
    edges: np.ndarray,
) -> tuple:
    """Twin of `search_plan.decide` for wedges: vx, vy, turn rate, goal x, y, utilisation, and the memory."""
    now, dt, horizon = numbers[NOW], numbers[DT], max(search[HORIZON], numbers[DT])
    seen, ids, last = memory
    seen = seen.copy()
    _mark_view(seen, table, now, search[BIN])
    goal_x, goal_y, utilisation = _best_goal(numbers, search, states, weights, seen, partners, directions)
    vx, vy = (goal_x - numbers[X]) / horizon, (goal_y - numbers[Y]) / horizon
    order = sort_by_id(around[2], np.arange(len(around[2])))
    near_states, near_weights, near_ids = around[0][order], around[1][order], around[2][order]
    near_last = _last_sight(near_states, near_ids, ids, last, table, seen, now, search)
    x, y = numbers[X] + vx * dt, numbers[Y] + vy * dt
    unserved = _unserved_particle_shares(numbers, x, y, near_states, partners, search[BIN])
    turn = _best_turn(numbers, search, x, y, near_states, near_weights, near_last, unserved, edges)
    return vx, vy, turn / dt, goal_x, goal_y, utilisation, (seen, near_ids, near_last)
