"""The UTIAS multi-robot data set (MRCLAM): five robots with cameras among 15 landmarks.

Two forms of a folder are read. The original one holds `RobotN_Groundtruth.dat`, `RobotN_Measurement.dat`, `Landmark_Groundtruth.dat` and
`Barcodes.dat`. The other holds three CSV files whose names end in `_poses_5hz.csv`, `_detections.csv` and `_landmarks.csv`.

Rules. The barcodes say who was seen. They are hidden: a detection is a range and a bearing, and nothing else. The targets are the
landmarks and the robots.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from protocol.settings import BadSetting
from world.config import RecordedSettings
from world.recorded.lines import Line, Remarks, blank_lines, csv_lines
from world.recorded.tracks import RecordedWorld, ReplayedBody, Visit

ROBOTS = 5
LAST = 0.5  # s after the last line for which everything stays: a tick may fall behind it
SAME_FRAME = 0.01  # s: times of one image differ by a millisecond
FARTHEST = 100.0  # m: no barcode is read from farther away


class Sight(NamedTuple):
    """One measurement of a robot."""

    time: float  # s
    robot: int
    distance: float  # m
    bearing: float  # rad


class Tables(NamedTuple):
    """The contents of a folder; times in s, of the original form from its first pose, of CSV files as they stand there."""

    poses: dict[int, list[tuple[float, float, float, float]]]  # of each robot: time, x, y, heading
    sights: list[Sight]
    landmarks: dict[int, tuple[float, float]]
    remarks: tuple[str, ...]


def read_mrclam(folder: Path, settings: RecordedSettings) -> RecordedWorld:
    """The recording in a folder; raises BadSetting naming file and line."""
    if not folder.is_dir():
        raise BadSetting(f"recorded.data = {str(folder)!r}: should be the folder of your copy of the MRCLAM data set")
    csv = sorted(folder.glob("*_poses_5hz.csv"))
    tables = read_csv(csv[0], settings) if csv else read_original(folder, settings)
    robots = [_robot(tables, number, settings) for number in sorted(tables.poses)]
    end = LAST + max([*(float(robot.times[-1]) for robot in robots), *(sight.time for sight in tables.sights)])
    still = [_still(number, place, end, settings) for number, place in sorted(tables.landmarks.items())]
    moving = [_there_until(end, number, robot) for number, robot in zip(sorted(tables.poses), robots)]
    return RecordedWorld(end, [*moving, *still], robots, tables.remarks)


def read_csv(poses_file: Path, settings: RecordedSettings) -> Tables:
    """The three CSV files of a folder, given that of the poses."""
    stem = poses_file.name.removesuffix("_poses_5hz.csv")
    sights_file, landmarks_file = (poses_file.with_name(f"{stem}_{what}.csv") for what in ("detections", "landmarks"))
    poses: dict[int, list[tuple[float, float, float, float]]] = defaultdict(list)
    names = ("t_s", "robot", "x_m", "y_m", "heading_rad")
    for line in csv_lines(poses_file, names):
        _add_pose(poses[line.whole(1, "robot")], line, [line.value(column, names[column]) for column in (0, 2, 3, 4)], settings)
    remarks, sights, lines = Remarks(sights_file), [], csv_lines(sights_file, ("t_s", "robot", "range_m", "bearing_rad", "true_subject"))
    for line in lines:
        sight = Sight(line.value(0, "t_s"), line.whole(1, "robot"), line.value(2, "range_m"), line.value(3, "bearing_rad"))
        if _is_possible(sight, line, remarks):
            sights.append(sight)
    landmarks = {
        line.whole(0, "subject"): (line.value(1, "x_m"), line.value(2, "y_m"))
        for line in csv_lines(landmarks_file, ("subject", "x_m", "y_m"))
    }
    return Tables(dict(poses), sights, landmarks, remarks.check(len(lines)))


def read_original(folder: Path, settings: RecordedSettings) -> Tables:
    """The files of the data set as it is published; times count from the first pose."""
    poses: dict[int, list[tuple[float, float, float, float]]] = {}
    sights: list[Sight] = []
    remarks: list[str] = []
    names = ("time", "x", "y", "orientation")
    for robot in range(1, ROBOTS + 1):
        known = poses[robot] = []
        for line in blank_lines(folder / f"Robot{robot}_Groundtruth.dat", names):
            values = [line.value(column, name) for column, name in enumerate(names)]
            _add_pose(known, line, values, settings)
    first = min(known[0][0] for known in poses.values())
    for robot in range(1, ROBOTS + 1):
        file = folder / f"Robot{robot}_Measurement.dat"
        own, lines = Remarks(file), blank_lines(file, ("time", "barcode", "range", "bearing"))
        for line in lines:
            sight = Sight(line.value(0, "time") - first, robot, line.value(2, "range"), line.value(3, "bearing"))
            if _is_possible(sight, line, own):
                sights.append(sight)
        remarks += own.check(len(lines))
    stated = blank_lines(folder / "Landmark_Groundtruth.dat", ("subject", "x", "y", "x std-dev", "y std-dev"))
    landmarks = {line.whole(0, "subject"): (line.value(1, "x"), line.value(2, "y")) for line in stated}
    shifted = {robot: [(time - first, x, y, heading) for time, x, y, heading in known] for robot, known in poses.items()}
    return Tables(shifted, sights, landmarks, tuple(remarks))


def _add_pose(known: list[tuple[float, float, float, float]], line: Line, values: Sequence[float], settings: RecordedSettings) -> None:
    """Add time, x, y and heading to those of a robot; raises BadSetting where times do not rise, or have a hole."""
    time, x, y, heading = values
    if known and not time - known[-1][0] > 0.0:
        raise BadSetting(f"{line.place}: time = {time:g} after {known[-1][0]:g}; the poses of a robot should be in the order of time")
    if known and time - known[-1][0] > settings.longest_hole:
        hole = f"{line.place}: a hole of {time - known[-1][0]:g} s in the poses of a robot"
        raise BadSetting(f"{hole}; should be at most recorded.longest_hole = {settings.longest_hole:g} s")
    turns = round((heading - known[-1][3]) / (2.0 * math.pi)) if known else 0  # the headings of a file may be wrapped
    known.append((time, x, y, heading - 2.0 * math.pi * turns))


def _is_possible(sight: Sight, line: Line, remarks: Remarks) -> bool:
    """Whether a measurement can be true; a remark if not."""
    if not -math.pi <= sight.bearing <= math.pi:
        remarks.leave_out(line, f"bearing = {sight.bearing:g} rad: should lie within +-pi")
    elif not 0.0 < sight.distance <= FARTHEST:
        remarks.leave_out(line, f"range = {sight.distance:g} m: should lie in (0, {FARTHEST:g}] m")
    elif not 1 <= sight.robot <= ROBOTS:
        remarks.leave_out(line, f"robot = {sight.robot}: should be 1 to {ROBOTS}")
    else:
        return True
    return False


def _robot(tables: Tables, number: int, settings: RecordedSettings) -> ReplayedBody:
    """A robot with its poses and its frames, in the frame of the arena."""
    table = np.array(tables.poses[number])
    poses = table[:, 1:] - np.array([*settings.origin, 0.0])
    own = sorted([sight for sight in tables.sights if sight.robot == number], key=lambda sight: sight.time)
    frames: list[list[Sight]] = []
    for sight in own:
        if frames and sight.time - frames[-1][0].time <= SAME_FRAME:
            frames[-1].append(sight)
        else:
            frames.append([sight])
    moments = np.array([frame[0].time for frame in frames])
    return ReplayedBody(table[:, 0], poses, moments, [np.array([(one.distance, one.bearing) for one in frame]) for frame in frames])


def _there_until(end: float, number: int, robot: ReplayedBody) -> Visit:
    """A robot as a target: where its poses end it stands until the last measurement."""
    return Visit(number, np.append(robot.times, end), np.vstack([robot.poses[:, :2], robot.poses[-1:, :2]]))


def _still(number: int, place: tuple[float, float], end: float, settings: RecordedSettings) -> Visit:
    """A landmark, which is there all the time."""
    at = np.array(place) - np.array(settings.origin)
    return Visit(number, np.array([0.0, end]), np.array([at, at]))
