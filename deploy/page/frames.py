"""What goes to a browser: a greeting with everything that a newcomer needs, then frames, each of which stands for itself.

A frame is binary: the length of a JSON text (uint32, little-endian), the text, and the density of the PHD as bytes, row by row from
the south: 255 x (1 - exp(-density / full)) per square of the grid, full = min(0.25 per m^2, 0.15 per square). A frame that is lost is
lost: the next one says it all. A comparison has a second moment, `beside`, and a second density after the first.
"""

import math
import struct
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from deploy.page.picture import Happening, KnownAgent, Picture, silent_after
from deploy.scenario import has_targets
from deploy.scoring.scorer import Score
from protocol.keys import order
from protocol.observer_messages import Estimate

LONGEST_SIDE = 128  # squares of the density grid
FULL_DENSITY = 0.25  # expected targets per m^2 at which the grid is at 63 % of its range,
FULL_SQUARE = 0.15  # or so many in a square of the grid, where squares are larger than those of 100 m
RECENT = 30  # happenings that every frame repeats, or
RECENT_PER_AGENT = 3  # so many for each agent: a whole team may be lost, and told of, between two frames
MOST_POINTS = 1200  # of a curve in a greeting
MOST_PARTICLES = 3000  # of one agent's belief
CURVES = ("time", "ospa", "gospa", "targets", "estimated", "mass", "hole", "overlap")
COMPARED = ("ospa", "gospa", "targets")  # of them those that need true targets

_encode = msgspec.json.Encoder().encode


def greeting(picture: Picture, scores: Sequence[Score], about: dict[str, Any]) -> bytes:
    """All that does not change from frame to frame, the curves so far, the whole time line and the trails, as JSON."""
    run, arena = picture.scenario.run, picture.scenario.arena
    data = {
        "type": "hello",
        "run": run.name,
        "scenario": run.scenario,
        "seed": run.seed,
        "dt": run.dt,
        "ticks": run.ticks,
        "partition": picture.scenario.partition.kind,
        "arena": [arena.width, arena.height],
        "cutoff": picture.scenario.study.cutoff,
        "silent": silent_after(picture.scenario) * run.dt,
        "agents": [_outfit(known) for known in picture.agents.values()],
        "curves": curves(scores, has_targets(picture.scenario)),
        "happenings": [_happening(one) for one in picture.happenings],
        "trails": trails(picture),
        **about,
    }
    return _encode(data)


def frame(picture: Picture, score: Score | None, extra: dict[str, Any], beside: tuple[Picture, Score | None] | None = None) -> bytes:
    """The picture of this moment, and that of a second swarm beside it where there is one."""
    data, density = _drawn(picture, score)
    data.update(extra)
    if beside is not None:
        data["beside"], other = _drawn(*beside)
        density += other
    text = _encode(data)
    return struct.pack("<I", len(text)) + text + density


def _drawn(picture: Picture, score: Score | None) -> tuple[dict[str, Any], bytes]:
    """The two parts of a frame: what is said in JSON, and the density."""
    data = moment(picture, score)
    density, size, square = density_grid(picture)
    data["grid"] = [*size, square]
    return data, density.tobytes()


def moment(picture: Picture, score: Score | None) -> dict[str, Any]:
    """What a frame says in its JSON part: the tick of the score, of which everything has been heard. Lengths in m, to the centimetre."""
    newest = picture.truth.tick if picture.truth else 0
    picture.show(score.tick if score else newest - 1)
    truth, recent = picture.shown, max(RECENT, RECENT_PER_AGENT * len(picture.agents))
    return {
        "type": "frame",
        "tick": truth.tick if truth else -1,
        "time": truth.time if truth else 0.0,
        "score": curve_values(score, has_targets(picture.scenario)),
        "messages": picture.messages,
        "targets": _flat(truth.targets) if truth else [],
        "ids": [int(number) % 2**31 for number in truth.ids] if truth else [],
        "agents": [_agent(picture, known) for known in picture.agents.values()],
        "happenings": [_happening(one) for one in list(picture.happenings)[-recent:]],
    }


def curve_values(score: Score | None, compares: bool) -> list[float | None] | None:
    """The figures of a tick in the order of `CURVES`; None for those of `COMPARED` unless there are true targets."""
    return [_figure(score, name, compares) for name in CURVES] if score else None


def thinned(scores: Sequence[Score]) -> Sequence[Score]:
    """At most `MOST_POINTS` of them: one of each few, that with the largest hole and overlap, for these come and go within a tick."""
    step = max(1, math.ceil(len(scores) / MOST_POINTS))
    return [max(scores[at : at + step], key=lambda score: score.hole + score.overlap) for at in range(0, len(scores), step)]


def curves(scores: Sequence[Score], compares: bool = True) -> dict[str, list[float | None]]:
    """The scores by name, thinned out; `compares` as in `curve_values`."""
    kept = thinned(scores)
    return {name: [_figure(score, name, compares) for score in kept] for name in CURVES}


def beside(scores: Sequence[Score], others: Sequence[Score], compares: bool = True) -> list[float | None]:
    """The OSPA of another swarm at the points of the curves of these scores, m; None where it has none. `compares` as above."""
    errors = {score.tick: _figure(score, "ospa", compares) for score in others}
    return [errors.get(score.tick) for score in thinned(scores)]


def _figure(score: Score, name: str, compares: bool) -> float | None:
    return round(float(getattr(score, name)), 4) if compares or name not in COMPARED else None


def trails(picture: Picture) -> dict[str, Any]:
    """Where bodies and targets have been lately: times, and per name or id the ways x, y, x, y, ..."""
    bodies: dict[str, list[float]] = {}
    targets: dict[str, list[float]] = {}
    for truth in picture.trail:
        for name, pose in zip(truth.bodies, truth.poses.tolist()):
            bodies.setdefault(name, []).extend([truth.time, round(pose[0], 2), round(pose[1], 2)])
        for number, place in zip(truth.ids.tolist(), truth.targets.tolist()):
            targets.setdefault(str(number % 2**31), []).extend([truth.time, round(place[0], 2), round(place[1], 2)])
    return {"bodies": bodies, "targets": targets}


def density_grid(picture: Picture) -> tuple[np.ndarray, tuple[int, int], float]:
    """The density of the PHD as bytes (rows, columns), the size (columns, rows), and the side of a square in m."""
    arena = picture.scenario.arena
    square = max(arena.width, arena.height) / LONGEST_SIDE
    columns, rows = max(1, math.ceil(arena.width / square)), max(1, math.ceil(arena.height / square))
    particles = picture.particles()
    column = np.clip((particles[:, 0] / square).astype(int), 0, columns - 1)
    row = np.clip((particles[:, 1] / square).astype(int), 0, rows - 1)
    mass = np.bincount(row * columns + column, weights=particles[:, 2], minlength=rows * columns).reshape(rows, columns)
    smooth = _blurred(_blurred(mass, 0), 1) / square**2
    full = min(FULL_DENSITY, FULL_SQUARE / square**2)
    return np.rint(255.0 * (1.0 - np.exp(-smooth / full))).astype(np.uint8), (columns, rows), square


def _blurred(grid: np.ndarray, axis: int) -> np.ndarray:
    """A grid after one step of (1, 2, 1) / 4 along an axis."""
    result = 0.5 * grid
    first, last = np.moveaxis(grid, axis, 0), np.moveaxis(result, axis, 0)
    last[1:] += 0.25 * first[:-1]
    last[:-1] += 0.25 * first[1:]
    return result


def _outfit(known: KnownAgent) -> dict[str, Any]:
    """Name, class and footprint at the origin of an agent."""
    outline = known.sensor.footprint((0.0, 0.0, 0.0)) if known.sensor else np.empty((0, 2))
    return {"name": known.name, "class": known.sensor_class, "outline": _flat(outline)}


def _agent(picture: Picture, known: KnownAgent) -> dict[str, Any]:
    gossip, estimate = picture.said(known)
    pose, alive = picture.pose(known.name), picture.is_alive(known)
    data: dict[str, Any] = {"name": known.name, "state": known.state, "incarnation": known.incarnation, "age": picture.age(known)}
    data["pose"] = [round(pose[0], 2), round(pose[1], 2), round(pose[2], 3)] if pose else None
    if gossip is not None:
        data["seen"] = _flat(known.places(gossip)) if alive else []
        data["said"] = gossip.tick
        data["cod"], data["radius"] = [round(gossip.cod[0], 2), round(gossip.cod[1], 2)], round(gossip.power_radius, 2)
    if estimate is not None:
        rejected = sum(count for name, count in estimate.counters.items() if name.startswith("rejected."))
        data["cell"] = _flat(estimate.cell) if alive else []
        data["targets"] = _flat(estimate.targets) if alive else []
        data["neighbours"] = estimate.neighbours
        data["labels"] = estimate.labels.tolist() if alive else []
        data["velocities"] = _flat(estimate.details[:, :2]) if alive else []
        data["unused"], data["load"], data["mass"] = round(estimate.unused, 2), round(estimate.load, 3), round(estimate.mass, 3)
        data["skipped"], data["late"] = estimate.counters.get("skipped", 0), estimate.counters.get("late", 0)
        data["ms"], data["rejected"] = round(1000.0 * estimate.round_seconds, 2), rejected + known.rejected
    return data


def belief(picture: Picture, name: str) -> dict[str, Any] | None:
    """The belief of one agent at the tick that is drawn: its claim, its cell, its particles; None for an unknown name."""
    known = picture.agents.get(name)
    if known is None:
        return None
    gossip, (seen, estimate) = picture.outcome(known), picture.said(known)
    data: dict[str, Any] = {"name": name, "class": known.sensor_class, "state": known.state, "incarnation": known.incarnation}
    data["age"] = picture.age(known)
    if gossip is not None:
        states = gossip.states if len(gossip.states) else gossip.components["place"]
        step = max(1, math.ceil(len(states) / MOST_PARTICLES))
        places = [round_pair(place) for place in gossip.claim.tolist()]
        data["claim"] = [{"name": who, "at": place[:2], "radius": place[2]} for who, place in zip(gossip.claim_names, places)]
        data["particles"], data["weight"] = _flat(states[::step, :2]), gossip.weight
        data["detections"], data["listening"] = _flat(known.places(seen or gossip)), gossip.listening
    if estimate is not None:
        data["neighbours"] = sorted(estimate.neighbours, key=order)
        data["cell"], data["targets"] = _flat(estimate.cell), _flat(estimate.targets)
        data["unused"], data["load"], data["mass"] = estimate.unused, estimate.load, estimate.mass
        data["counters"], data["tick"] = estimate.counters, estimate.tick
        data["agree"] = agreement(picture, estimate)
    return data


def agreement(picture: Picture, mine: Estimate) -> list[int]:
    """How many live agents cut the same diagram as the sender of an estimate in its tick, and how many have spoken of that tick."""
    others = [other.estimates.get(mine.tick) for other in picture.agents.values() if other.alive]
    spoken = [estimate for estimate in others if estimate is not None]
    return [sum(estimate.diagram_hash == mine.diagram_hash for estimate in spoken), len(spoken)]


def round_pair(values: Sequence[float]) -> list[float]:
    """Numbers rounded to the centimetre."""
    return [round(value, 2) for value in values]


def _flat(points: np.ndarray) -> list[float]:
    """x, y, x, y, ... rounded to the centimetre."""
    return np.round(points.astype(float), 2).ravel().tolist()


def _happening(one: Happening) -> list[Any]:
    return [one.number, round(one.time, 2), one.kind, one.who, one.text]
