"""The tracks of recorded targets: who was where, and when.

Data types: a `Visit` is a stretch of time in which a target was there without a break; `RecordedWorld` is all that a loader returns.
Times in s since the first line of the recording, places in m in the frame of the arena.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from protocol.sensing import Pose
from protocol.settings import BadSetting
from world.recorded.lines import Line


class Report(NamedTuple):
    """One report of a target."""

    time: float  # s
    x: float  # m
    y: float
    line: Line


class Visit(NamedTuple):
    """A target from its appearance to its leaving: times (N,) ascending, places (N, 2)."""

    target: int
    times: np.ndarray
    places: np.ndarray

    def at(self, time: float) -> tuple[float, float]:
        """The place at a time within the visit, linear between two reports."""
        return float(np.interp(time, self.times, self.places[:, 0])), float(np.interp(time, self.times, self.places[:, 1]))


class ReplayedBody(NamedTuple):
    """A robot that was recorded: where it was, and what its sensor returned."""

    times: np.ndarray  # (N,) ascending, s
    poses: np.ndarray  # (N, 3): x m, y m, heading rad, unwrapped
    frame_times: np.ndarray  # (F,) ascending, s: when its sensor measured
    frames: Sequence[np.ndarray]  # of each the measurements (M, 2), as the sensor states them

    def at(self, time: float) -> Pose:
        """The pose at a time, linear between two lines and constant beyond them."""
        x, y, heading = (float(np.interp(time, self.times, column)) for column in self.poses.T)
        return x, y, heading


class RecordedWorld(NamedTuple):
    """What a loader returns."""

    seconds: float  # from the first line to the last
    visits: Sequence[Visit]
    bodies: Sequence[ReplayedBody]  # none: the bodies are simulated
    remarks: tuple[str, ...]  # the lines that were left out, and targets that were away in between


def without_leaps(
    reports: Sequence[Report], speed: Callable[[Report, Report], float], fastest: float
) -> tuple[list[Report], list[tuple[Report, float]]]:
    """The reports of one target that can be true, and those that cannot, each with its `speed` from or to another, m/s.

    Of two reports that contradict each other, the next one decides; without its word the earlier one is kept. Of agreeing reports of
    one time the first counts.
    """
    kept: list[Report] = []
    wrong: list[tuple[Report, float]] = []
    for number, report in enumerate(reports):
        leap = speed(kept[-1], report) if kept else 0.0
        if leap > fastest:
            third = next((reports[n] for n in range(number + 1, len(reports)) if reports[n].time > report.time), None)
            is_first_wrong = third is not None and speed(report, third) <= fastest < speed(kept[-1], third)
            if not is_first_wrong or (len(kept) > 1 and speed(kept[-2], report) > fastest):
                wrong.append((report, leap))
                continue
            wrong.append((kept.pop(), leap))
        if not kept or report.time > kept[-1].time:
            kept.append(report)
    return kept, wrong


def visits_of(target: int, reports: Sequence[Report], longest_gap: float) -> list[Visit]:
    """The visits of one target: it is away where it is silent for more than `longest_gap` s."""
    times = np.array([report.time for report in reports])
    places = np.array([(report.x, report.y) for report in reports])
    ends = np.flatnonzero(np.diff(times) > longest_gap) + 1
    return [Visit(target, *part) for part in zip(np.split(times, ends), np.split(places, ends))]


def tracks_of(reports: Mapping[int, Sequence[Report]], longest_gap: float, name: str) -> tuple[list[Visit], list[str]]:
    """All visits, and a remark for each target that was away in between; `name` is what the file calls a target."""
    visits: list[Visit] = []
    remarks: list[str] = []
    for target, known in reports.items():
        found = visits_of(target, known, longest_gap)
        visits += found
        after = 0
        for before, following in pairwise(found):
            after += len(before.times)
            gap = following.times[0] - before.times[-1]
            remarks.append(f"{known[after].line.place}: {name} {target} was silent for {gap:.1f} s; it is away in between")
    return visits, remarks


def check_no_hole(lines: Sequence[Line], times: Sequence[float], longest_hole: float) -> None:
    """Raise BadSetting where times fall, or where nobody reports anything for more than `longest_hole` s."""
    for line, before, after in zip(lines[1:], times, times[1:]):
        if after < before:
            raise BadSetting(f"{line.place}: the time falls by {before - after:g} s; lines should be in the order of time")
        if after - before > longest_hole:
            hole = f"{line.place}: a hole of {after - before:g} s in which there is no line"
            raise BadSetting(f"{hole}; should be at most recorded.longest_hole = {longest_hole:g} s")
