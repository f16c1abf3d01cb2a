"""What a place is worth to a sensor that searches and tracks, from docs/explanation/search-and-track.md, one bin after the other.

Rows are tuples of numbers: a particle is x, y, vx, vy and weight; a partner is goal x, goal y, utilisation, reach, and 1 if its name comes
before. `own` holds the numbers of the sensor by name, `search` the settings, `last(x, y)` the time of the last sight of a place, s.
"""

import math
from collections import defaultdict
from collections.abc import Callable
from typing import Any

Bin = tuple[float, float, float, float]  # its centre x, y in m, its tracks and its value of search, as far as they are left to the sensor
Rows = list[tuple[float, ...]]
MARGIN, PLAN, PARTNER, DECAY = 0.75, 7.5, 4.0, 3.0  # bins
BESIDE = 0.4  # value of a track just outside of the circle


def bins(
    particles: Rows, partners: Rows, last: Callable[[float, float], float], own: dict[str, float], search: dict[str, Any]
) -> list[Bin]:
    """The bins around the announced goal that are worth anything."""
    side, sides, ahead = search["bin"], (own["width"], own["height"]), search["horizon"] + own["dt"]
    worth: dict[tuple[int, int], list[float]] = defaultdict(lambda: [0.0, 0.0])
    for x, y, vx, vy, weight in particles:
        place = [x + vx * ahead, y + vy * ahead]
        if not own["is_open"]:
            place = [abs(at) if at < length else 2.0 * length - at for at, length in zip(place, sides)]
        if all(0.0 <= at <= length for at, length in zip(place, sides)):
            seen = any(
                own["now"] - last(x - vx * ago, y - vy * ago) <= search["stale"] for ago in (0.0, search["stale"] / 2, search["stale"])
            )
            worth[int(place[0] // side), int(place[1] // side)][0 if seen else 1] += weight if seen else search["weight"] * weight
    columns, rows = (math.ceil(length / side) for length in sides)
    edge = [(c, r) for c in range(columns) for r in range(rows) if c in (0, columns - 1) or r in (0, rows - 1)]
    for place_of_bin in edge if own["is_open"] else []:
        worth[place_of_bin][1] += search["inflow"]
    found = []
    for (column, row), (track, value) in worth.items():
        x, y, radius = (column + 0.5) * side, (row + 0.5) * side, circle(own["reach"], side)
        apart = math.hypot(x - own["goal_x"], y - own["goal_y"])
        if apart <= radius + PLAN * side and column < columns and row < rows:
            for goal_x, goal_y, utilisation, reach, first in partners:
                far, theirs = math.hypot(x - goal_x, y - goal_y), circle(reach, side)
                ahead_of_us = (cost(far, theirs), -first) < (cost(apart, radius), 0.0)
                if far <= theirs + PARTNER * side and ahead_of_us:
                    fade = math.exp(-max(far - theirs, 0.0) / (DECAY * side))
                    held = min(1.0, 1.0 / utilisation) if utilisation > 0.0 else 1.0
                    track *= 1.0 - search["sharing"] * held * fade * (1.0 if far <= theirs else BESIDE)
                    value *= 1.0 - search["sharing"] * fade
            found.append((x, y, track, value))
    return found


def circle(reach: float, side: float) -> float:
    """The radius that a sensor serves, m."""
    return max(reach - MARGIN * side, 0.5 * side)


def cost(apart: float, radius: float) -> float:
    """How far a sensor is from serving a place: inside a share of the radius, outside the metres beyond."""
    return apart / radius - 1.0 if apart <= radius else apart - radius


def utilisation(known: list[Bin], own: dict[str, float], search: dict[str, Any]) -> float:
    """The tracks in the circle of the announced goal, as a multiple of what the sensor can hold."""
    inside = circle(own["reach"], search["bin"])
    tracks = math.fsum(track for x, y, track, _ in known if math.hypot(x - own["goal_x"], y - own["goal_y"]) <= inside)
    return tracks / (search["capacity"] * own["angle"] / math.radians(45.0))


def worth_of(place: tuple[float, float], known: list[Bin], own: dict[str, float], search: dict[str, Any]) -> float:
    """What the bins are worth from a place, less the cost of moving the goal there."""
    side, found = search["bin"], 0.0
    radius = circle(own["reach"], side)
    best = min(own["offset"], 0.9 * radius)
    for x, y, track, value in known:
        apart = math.hypot(x - place[0], y - place[1])
        if apart <= radius:
            share = (apart - best) / (radius - best) if apart > best else (best - apart) / best
            found += track * (1.0 - search["falloff"] * share * share) + value
        else:
            found += (BESIDE * track + value) * math.exp(-(apart - radius) / (DECAY * side))
    moved = math.hypot(place[0] - own["goal_x"], place[1] - own["goal_y"])
    return found - search["step_cost"] * moved / (search["horizon"] * own["speed"])


def candidates(own: dict[str, float], search: dict[str, Any]) -> list[tuple[float, float]]:
    """The places that are compared: stay, or go half of the horizon or all of it in one of 16 directions, within the arena."""
    ways = [(0.0, 0.0)] + [
        (share * math.cos(math.pi * turn / 8.0), share * math.sin(math.pi * turn / 8.0)) for turn in range(16) for share in (0.5, 1.0)
    ]
    way = search["horizon"] * own["speed"]
    return [(min(max(own["x"] + way * x, 0.0), own["width"]), min(max(own["y"] + way * y, 0.0), own["height"])) for x, y in ways]
