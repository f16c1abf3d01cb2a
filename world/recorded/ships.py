"""Ships in a CSV file of AIS reports: Time, MMSI, Latitude_degrees, Longitude_degrees, COG_degrees, SOG_knots; times in UTC."""

import math
import re
from pathlib import Path

import numpy as np

from protocol.settings import BadSetting
from world.config import RecordedSettings
from world.recorded.lines import Line, Remarks, csv_lines
from world.recorded.local_frame import LocalFrame
from world.recorded.tracks import RecordedWorld, Report, check_no_hole, tracks_of, without_leaps

COLUMNS = ("Time", "MMSI", "Latitude_degrees", "Longitude_degrees", "COG_degrees", "SOG_knots")
FARTHEST = 2.0e5  # m from the origin: no coastal station receives a ship from farther away
FASTEST = 60.0  # m/s: no ship sails faster
TIME = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?Z?", re.ASCII)
JITTER = 50.0  # m that two reports may be apart however short the time between them: antennas, and times of receipt


def read_ships(path: Path, settings: RecordedSettings) -> RecordedWorld:
    """The recording in a file; raises BadSetting naming file and line. `settings.origin` is latitude and longitude in degrees."""
    _check_origin(settings)
    lines, remarks, frame = csv_lines(path, COLUMNS), Remarks(path), LocalFrame(*settings.origin)
    moments = [_moment(line) for line in lines]
    times = [float((moment - moments[0]) / np.timedelta64(1, "ms")) / 1000.0 for moment in moments]
    check_no_hole(lines, times, settings.longest_hole)
    reports: dict[int, list[Report]] = {}
    for line, time in zip(lines, times):
        ship, latitude, longitude = line.whole(1, "MMSI"), line.value(2, "Latitude_degrees"), line.value(3, "Longitude_degrees")
        if abs(latitude) > 90.0 or abs(longitude) > 180.0:
            remarks.leave_out(line, f"latitude {latitude:g}, longitude {longitude:g}: should lie within +-90 and +-180 degrees")
            continue
        report = Report(time, *frame.to_plane(latitude, longitude), line)
        away = math.hypot(report.x, report.y)
        if away > FARTHEST or abs((longitude - settings.origin[1] + 180.0) % 360.0 - 180.0) > 90.0:
            from_origin = f"latitude {latitude:g}, longitude {longitude:g}: {away / 1000.0:.0f} km from recorded.origin"
            remarks.leave_out(line, f"{from_origin}; should be at most {FARTHEST / 1000.0:g} km")
        else:
            reports.setdefault(ship, []).append(report)
    found: dict[int, list[Report]] = {}
    for ship, known in reports.items():
        found[ship], wrong = without_leaps(known, _jump, FASTEST)  # a report that two stations received counts once
        for report, speed in wrong:
            remarks.leave_out(report.line, f"MMSI {ship} at {speed:.0f} m/s: should be at most {FASTEST:g} m/s")
    visits, silent = tracks_of(found, settings.longest_gap, "MMSI")
    return RecordedWorld(times[-1], visits, (), (*remarks.check(len(lines)), *silent))


def _check_origin(settings: RecordedSettings) -> None:
    latitude, longitude = settings.origin
    if abs(latitude) > 89.0 or abs(longitude) > 180.0:
        raise BadSetting(f"recorded.origin = {list(settings.origin)}: should be latitude and longitude in degrees")


def _moment(line: Line) -> np.datetime64:
    text = line.cells[0]
    try:
        if TIME.fullmatch(text):  # numpy takes offsets and words such as `now` too
            return np.datetime64(text.removesuffix("Z"), "ms")
    except ValueError:
        pass  # such as the thirteenth month
    raise BadSetting(f"{line.place}: Time = {text!r}: should be such as 2016-01-12 13:02:11.218, in UTC")


def _jump(before: Report, after: Report) -> float:
    """The least speed at which a ship can have given both reports, m/s."""
    apart = max(0.0, math.hypot(after.x - before.x, after.y - before.y) - JITTER)
    return apart / max(after.time - before.time, 1.0)
