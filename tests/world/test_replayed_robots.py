"""Replayed robots: the two forms of the MRCLAM folder, its mistakes by file and line, and each measurement in one scan."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from deploy.scenario import resolve, world_config
from protocol.settings import BadSetting
from world.config import RecordedSettings
from world.recorded.mrclam import read_mrclam
from world.recorded.robots import ReplayedBodies, from_other_pose, scans_by_tick
from world.recorded.targets import RecordedTargets
from world.recorded.tracks import ReplayedBody
from world.sources import sources_of

SETTINGS = RecordedSettings(kind="mrclam", data="x", origin=(0.0, 0.0), longest_hole=1.0)
OWN_COPY = Path(os.environ.get("COVEY_MRCLAM", Path(__file__).resolve().parents[3] / "shared" / "realdata"))


def original(folder: Path, pose: str = "", sight: str = "") -> Path:
    """A folder as it is published: five robots for 2 s, a landmark that each of them sees 2 m ahead, and a line of one's own."""
    for robot in range(1, 6):
        poses = [f"{1000.0 + step / 5:.3f} {robot}.0 0.5 3.14" for step in range(11)] + ([pose] if pose and robot == 2 else [])
        sights = [f"{1000.05 + step / 4:.3f} 72 2.0 0.1" for step in range(7)] + ([sight] if sight and robot == 2 else [])
        (folder / f"Robot{robot}_Groundtruth.dat").write_text("# time x y orientation\n" + "\n".join(poses) + "\n")
        (folder / f"Robot{robot}_Measurement.dat").write_text("# time barcode range bearing\n" + "\n".join(sights) + "\n")
    (folder / "Landmark_Groundtruth.dat").write_text("# subject x y std std\n6 1.5 2.5 0.0001 0.0001\n")
    return folder


def in_csv(folder: Path, detection: str = "0.1,1,2.0,0.5,6", head: str = "t_s,robot,range_m,bearing_rad,true_subject") -> Path:
    """The same in CSV files, with one detection of one's own."""
    poses = [f"{step / 5},{robot},{robot}.0,0.5,3.0" for robot in range(1, 6) for step in range(11)]
    (folder / "a_poses_5hz.csv").write_text("t_s,robot,x_m,y_m,heading_rad\n" + "\n".join(poses) + "\n")
    (folder / "a_landmarks.csv").write_text("subject,x_m,y_m\n6,1.5,2.5\n")
    (folder / "a_detections.csv").write_text(f"{head}\n0.0,1,1.0,0.0,6\n{detection}\n")
    return folder


def test_the_published_form_gives_robots_landmarks_and_frames(tmp_path: Path) -> None:
    found = read_mrclam(original(tmp_path), SETTINGS)
    assert [len(robot.frames) for robot in found.bodies] == [7] * 5
    assert found.bodies[2].at(1.0) == pytest.approx((3.0, 0.5, 3.14))
    assert sorted(visit.target for visit in found.visits) == [1, 2, 3, 4, 5, 6]
    assert found.bodies[0].frame_times[0] == pytest.approx(0.05)


def test_headings_that_wrap_are_unwrapped(tmp_path: Path) -> None:
    original(tmp_path)
    (tmp_path / "Robot1_Groundtruth.dat").write_text("1000.0 0 0 3.1\n1000.2 0 0 -3.1\n1002.0 0 0 -3.1\n".replace("1002.0", "1000.9"))
    assert read_mrclam(tmp_path, SETTINGS).bodies[0].at(0.1)[2] == pytest.approx(math.pi)


def test_headings_of_csv_files_are_unwrapped_too_and_stay_to_the_last_bit_where_they_are_not_wrapped(tmp_path: Path) -> None:
    in_csv(tmp_path)
    headings = [3.1, -3.1, -2.9, 3.1, 0.1, -0.2, 0.3, 9.6, 9.7, 9.8, 9.9]
    poses = [f"{step / 5},{robot},1.0,0.5,{heading}" for robot in range(1, 6) for step, heading in enumerate(headings)]
    (tmp_path / "a_poses_5hz.csv").write_text("t_s,robot,x_m,y_m,heading_rad\n" + "\n".join(poses) + "\n")
    found = read_mrclam(tmp_path, SETTINGS).bodies[0]
    assert found.at(0.1)[2] == pytest.approx(math.pi)
    assert found.poses[:, 2].tolist()[3:6] == [3.1, 0.1, -0.2]


@pytest.mark.parametrize(
    ("pose", "sight", "said"),
    [
        (
            "1009.0 1 1 0",
            "",
            "Robot2_Groundtruth.dat, line 13: a hole of 7 s in the poses of a robot; should be at most recorded",
        ),
        (
            "1001.0 1 1 0",
            "",
            "Robot2_Groundtruth.dat, line 13: time = 1001 after 1002; the poses of a robot should be",
        ),
        ("1002.2 1 1", "", "Robot2_Groundtruth.dat, line 13: 3 columns; should be 4"),
        ("", "1001.0 72 far 0.1", "Robot2_Measurement.dat, line 9: range = 'far': should be a finite number"),
    ],
)
def test_a_published_file_that_breaks_its_form_is_refused_by_file_and_line(tmp_path: Path, pose: str, sight: str, said: str) -> None:
    with pytest.raises(BadSetting) as error:
        read_mrclam(original(tmp_path, pose, sight), SETTINGS)
    assert str(error.value).startswith(f"{tmp_path}/{said}")


@pytest.mark.parametrize(
    ("detection", "said"),
    [
        ("0.1,1,2.0,3.5,6", "bearing = 3.5 rad: should lie within +-pi; the line is left out"),
        ("0.1,1,-2.0,0.5,6", "range = -2 m: should lie in (0, 100] m; the line is left out"),
        ("0.1,9,2.0,0.5,6", "robot = 9: should be 1 to 5; the line is left out"),
    ],
)
def test_a_measurement_that_cannot_be_is_left_out_and_named_by_line(tmp_path: Path, detection: str, said: str) -> None:
    found = read_mrclam(in_csv(tmp_path, detection), SETTINGS)
    assert found.remarks == (f"{tmp_path}/a_detections.csv, line 3: {said}",)
    assert sum(len(frame) for robot in found.bodies for frame in robot.frames) == 1


def test_an_unknown_column_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match=r"a_detections.csv, line 1: column 'barcode' is unknown"):
        read_mrclam(in_csv(tmp_path, head="t_s,robot,range_m,bearing_rad,barcode"), SETTINGS)


def test_a_frame_goes_into_the_nearest_tick_and_never_two_into_one() -> None:
    frames = [np.array([[1.0, 0.1], [2.0, 0.2]]), np.array([[3.0, 0.3]]), np.array([[4.0, 0.4]])]
    robot = ReplayedBody(np.array([0.0, 10.0]), np.zeros((2, 3)), np.array([0.19, 0.27, 0.61]), frames)
    found = scans_by_tick(robot, dt=0.2, start=0.0, ticks=50)
    assert {tick: len(scan) for tick, scan in found.items()} == {1: 2, 2: 1, 3: 1}


def test_frames_that_come_faster_than_the_ticks_are_refused_and_not_delayed_ever_more() -> None:
    """A frame every .2 s; in ticks of .25 s every fifth has none of its own."""
    moments = np.arange(50) / 5.0
    robot = ReplayedBody(np.array([0.0, 10.0]), np.zeros((2, 3)), moments, [np.array([[1.0, 0.1]])] * 50)
    assert list(scans_by_tick(robot, dt=0.2, start=0.0, ticks=50)) == list(range(50))
    with pytest.raises(BadSetting, match=r"^run\.dt = 0\.25: the frame .* at 2\.\d* s .*; should be less than .* two frames, 0\.200 s$"):
        scans_by_tick(robot, dt=0.25, start=0.0, ticks=50)


def test_a_replay_from_the_middle_of_a_recording_states_each_measurement_from_where_the_robot_was_then() -> None:
    """A robot at .2 m/s; a landmark 3 m ahead of it, .1 s after second 600, which is the first of the replay."""
    robot = ReplayedBody(
        np.array([0.0, 1000.0]), np.array([[0.0, 0.0, 0.0], [200.0, 0.0, 0.0]]), np.array([600.1]), [np.array([[3.0, 0.0]])]
    )
    found = scans_by_tick(robot, dt=0.25, start=600.0, ticks=50)
    assert list(found) == [0]
    assert found[0][0] == pytest.approx([3.0 + 0.2 * 0.1, 0.0], abs=1e-6)


def test_the_scans_of_a_replay_begin_where_the_replay_begins(tmp_path: Path) -> None:
    """Of the frames at .05, .3, .. 1.55 s those from 1.05 s on, at most one a tick."""
    original(tmp_path)
    given = {"recorded.data": str(tmp_path), "recorded.start": 1.0, "run.seconds": 1.0, "run.dt": 0.25, "recorded.origin": [0.0, 0.0]}
    config = world_config(resolve("mrclam", given))
    (targets, bodies, detector), names = sources_of(config), list(config.members)
    assert isinstance(targets, RecordedTargets) and isinstance(bodies, ReplayedBodies)
    scans = [detector.scans([], [], names, np.empty((0, 2)), np.empty(0), tick, None) for tick in range(4)]  # type: ignore[arg-type]
    assert [[len(scan) for scan in tick] for tick in scans] == [[1] * 5] * 3 + [[0] * 5]


def test_a_team_of_another_size_than_that_of_the_recording_is_refused(tmp_path: Path) -> None:
    original(tmp_path)
    given = {"recorded.data": str(tmp_path), "recorded.start": 1.0, "run.seconds": 1.0, "team.composition": "R3"}
    with pytest.raises(BadSetting, match="members: 3 agents for a recording of 5 robots; should be as many"):
        sources_of(world_config(resolve("mrclam", given)))


def test_the_motion_of_the_robot_between_frame_and_tick_is_taken_out() -> None:
    stated = from_other_pose(np.array([[2.0, 0.5]]), (1.0, 1.0, 0.0), (1.0 + 2.0 * math.cos(0.5), 1.0, 0.5 * math.pi))
    assert stated[0] == pytest.approx([2.0 * math.sin(0.5), 0.0], abs=1e-12)


def test_all_measurements_of_a_copy_of_the_data_set_are_used() -> None:
    if not (OWN_COPY / "mrclam7_detections.csv").is_file():
        pytest.skip(f"no copy of the MRCLAM data set in {OWN_COPY}; COVEY_MRCLAM names one")
    config = world_config(resolve("mrclam", {"recorded.data": str(OWN_COPY)}))
    scene, count = sources_of(config), 0
    for tick in range(config.run.ticks):
        scans = scene.detector.scans([], [], list(config.members), np.empty((0, 2)), np.empty(0), tick, None)  # type: ignore[arg-type]
        count += sum(map(len, scans))
    assert count == 20282
