"""Pedestrians in the obsmat format: frame, person, x, z, y, vx, vz, vy between blanks; 25 frames a second, lengths in m."""

import math
from pathlib import Path

from protocol.settings import BadSetting
from world.config import RecordedSettings
from world.recorded.lines import Remarks, blank_lines
from world.recorded.tracks import RecordedWorld, Report, check_no_hole, tracks_of, without_leaps

FRAMES_PER_SECOND = 25.0
COLUMNS = ("frame", "person", "x", "z", "y", "vx", "vz", "vy")
FASTEST = 12.0  # m/s: nobody runs faster


def read_pedestrians(path: Path, settings: RecordedSettings) -> RecordedWorld:
    """The recording in a file; raises BadSetting naming file and line."""
    lines, remarks = blank_lines(path, COLUMNS), Remarks(path)
    frames = [line.whole(0, "frame") for line in lines]
    times = [(frame - frames[0]) / FRAMES_PER_SECOND for frame in frames]
    check_no_hole(lines, times, settings.longest_hole)
    reports: dict[int, list[Report]] = {}
    for line, time in zip(lines, times):
        person = line.whole(1, "person")
        report = Report(time, line.value(2, "x") - settings.origin[0], line.value(4, "y") - settings.origin[1], line)
        known = reports.setdefault(person, [])
        if known and known[-1].time == time:
            raise BadSetting(f"{line.place}: person = {person} stands in frame {line.cells[0]} twice")
        known.append(report)
    found: dict[int, list[Report]] = {}
    for person, known in reports.items():
        found[person], wrong = without_leaps(known, _speed, FASTEST)
        for report, speed in wrong:
            remarks.leave_out(report.line, f"person {person} at {speed:.0f} m/s: should be at most {FASTEST:g} m/s")
    visits, away = tracks_of(found, settings.longest_gap, "person")
    return RecordedWorld(times[-1], visits, (), (*remarks.check(len(lines)), *away))


def _speed(before: Report, after: Report) -> float:
    """The mean speed between two reports, m/s."""
    return math.sqrt((after.x - before.x) ** 2 + (after.y - before.y) ** 2) / (after.time - before.time)
