"""Exports to MOT, GeoJSON and Cursor-on-Target, read back with other libraries: motmetrics, geojson with shapely, and pytak."""

import gc
import json
import tracemalloc
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import shapely

from agents.tracking.labels import derived_label
from deploy.cli import recordings
from deploy.recording.geographic import earth_of, write_cot, write_geojson
from deploy.recording.mot import write_mot
from deploy.recording.observers import Observers, open_recorder
from deploy.recording.recorder import Recorder
from deploy.recording.recording import Recording
from deploy.recording.reported import ReportedTick, reported_ticks
from deploy.recording.rescore import rescore
from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol import codec
from protocol.fields import pack
from protocol.node import Alive, received
from protocol.observer_messages import Estimate, Truth
from protocol.settings import BadSetting
from world.recorded.local_frame import LocalFrame
from world.track_score import similarity

ORIGIN = (50.7, -1.2)
BEGAN = "2016-01-12T13:02:11Z"


def recorded(folder: Path, settings: dict[str, object], scenario: str = "quick") -> Recording:
    """5 s of a scenario; 20 ticks of `quick`."""
    file = folder / "a.mcap"
    simulation = Simulation(resolve(scenario, {"run.seconds": 5.0, "run.name": "seen", **settings}))
    Observers(simulation.scorer, open_recorder(file, simulation.scenario, virtual=True))
    simulation.run()
    return Recording(file)


def test_an_export_that_fails_leaves_an_earlier_file_and_other_recordings_as_they_are(tmp_path: Path) -> None:
    recording, out = recorded(tmp_path, {}), tmp_path / "good.cot"
    other = tmp_path / "other.mcap"
    other.write_bytes(recording.path.read_bytes())
    assert recordings.export(str(recording.path), "cot", out, ORIGIN, BEGAN) == 0
    before, spoilt = out.read_bytes(), bytearray(recording.path.read_bytes())
    spoilt[len(spoilt) // 2 : len(spoilt) // 2 + 40] = bytes(40)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(spoilt)
    with pytest.raises(BadSetting):
        recordings.export(str(damaged), "cot", out, ORIGIN, BEGAN)
    assert out.read_bytes() == before and not list(tmp_path.glob(".*"))
    with pytest.raises(BadSetting, match="is a recording; name another file"):
        recordings.export(str(recording.path), "foxglove", other)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A run in which every agent reports every tick."""
    return recorded(tmp_path_factory.mktemp("run"), {})


@pytest.fixture(scope="module")
def ticks(recording: Recording) -> list[ReportedTick]:
    """What it reported."""
    found = list(reported_ticks(recording))
    assert len(found) == 20 and sum(len(tick.targets) for tick in found) > 20
    return found


def test_motmetrics_reads_the_truth_with_its_names_and_the_estimates_as_detections(
    recording: Recording, ticks: list[ReportedTick], tmp_path: Path
) -> None:
    motmetrics = pytest.importorskip("motmetrics")
    files = write_mot(recording, tmp_path)
    assert [file.relative_to(tmp_path).as_posix() for file in files] == ["gt/gt.txt", "det/det.txt", "res/res.txt", "seqinfo.ini"]
    truth, found = (motmetrics.io.loadtxt(str(file), fmt="mot15-2D", min_confidence=-1) for file in files[:2])
    height, side = recording.scenario.arena.height, 2.0 * recording.scenario.study.cutoff
    for tick in ticks:
        rows = truth.loc[tick.truth.tick + 1]
        assert sorted(rows.index.tolist()) == sorted(tick.truth.ids.tolist())
        for name, place in zip(tick.truth.ids.tolist(), tick.truth.targets):
            row = rows.loc[name]
            left, top = row["X"] + 1.0, row["Y"] + 1.0  # motmetrics takes corners for pixels that count from 1
            middle = left + row["Width"] / 2.0, height - top - row["Height"] / 2.0
            assert middle == pytest.approx(tuple(place), abs=1e-5)
    assert (truth["Width"] == side).all()
    assert len(found) == sum(len(tick.targets) for tick in ticks) and set(found.index.get_level_values("Id")) == {-1}
    assert "seqLength=20" in files[3].read_text() and "frameRate=4" in files[3].read_text()


def test_no_rows_of_an_earlier_export_stay_in_the_folder(recording: Recording, tmp_path: Path) -> None:
    """Of a run without estimates the file of those with identities was not written, and that of another run stayed."""
    write_mot(recording, tmp_path / "mot")
    nothing = {"run.seconds": 1.0, "targets.count": 0, "detection.clutter": 0.0}
    files = write_mot(recorded(tmp_path, nothing), tmp_path / "mot")
    assert [file.read_text() for file in files[:3]] == ["", "", ""]


def test_targets_are_counted_from_1_whatever_their_file_calls_them(tmp_path: Path) -> None:
    """TrackEval makes two tables as long as the largest id: of ships, whose number has nine digits, 4 GB."""
    people = tmp_path / "people.txt"
    people.write_text("".join(f"{frame} {who} {1 + frame / 50} 0 5 0 0 0\n" for frame in range(0, 130, 10) for who in (235000001, 7)))
    settings: dict[str, object] = {"recorded.data": str(people), "recorded.origin": [0.0, 0.0]}
    frames = exported(write_mot(recorded(tmp_path, settings, "students03"), tmp_path))
    assert len(frames) == 12 and all(ids == [1, 2] for ids, *_ in frames)


def test_a_target_that_was_away_has_a_line_for_each_time_that_it_was_there(tmp_path: Path) -> None:
    """One line led straight across the time and the ground in between."""
    people = tmp_path / "people.txt"
    rows = [(frame, who) for frame in range(0, 130, 10) for who in (3, 7) if who == 3 or not 40 < frame < 90]
    people.write_text("".join(f"{frame} {who} {1 + frame / 50} 0 5 0 0 0\n" for frame, who in rows))
    settings: dict[str, object] = {"recorded.data": str(people), "recorded.origin": [0.0, 0.0], "recorded.longest_gap": 1.0}
    found = recorded(tmp_path, settings, "students03")
    write_geojson(found, earth_of(found, ORIGIN, BEGAN), tmp_path / "a.geojson")
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    times = [(one["properties"]["name"], len(one["properties"]["times"])) for one in features if one["properties"]["kind"] == "target"]
    assert times == [("3", 12), ("7", 5), ("7", 3)]


Exported = tuple[list[int], np.ndarray, list[int], np.ndarray]  # ids and places of targets, of estimates


def exported(files: list[Path]) -> list[Exported]:
    """The frames of gt.txt and res.txt: ids, and the places in the columns x and y."""
    truth, found = (np.loadtxt(file, delimiter=",", ndmin=2) for file in (files[0], files[2]))
    frames = []
    for frame in range(1, int(truth[:, 0].max()) + 1):
        parts = [rows[rows[:, 0] == frame] for rows in (truth, found)]
        (ids, targets), (labels, places) = [(part[:, 1].astype(int).tolist(), part[:, 7:9]) for part in parts]
        frames.append((ids, targets, labels, places))
    return frames


def indexed(values: list[list[int]]) -> list[np.ndarray]:
    """The same ids, counted from 0 without gaps."""
    known = sorted({value for row in values for value in row})
    return [np.array([known.index(value) for value in row], dtype=int) for row in values]


@pytest.mark.parametrize("every", [1, 4])
def test_trackeval_and_motmetrics_score_the_exported_tracks_as_the_run_does(every: int, tmp_path: Path) -> None:
    metrics, motmetrics = pytest.importorskip("trackeval").metrics, pytest.importorskip("motmetrics")
    recording = recorded(tmp_path, {"timing.estimate_every": every})
    frames, cutoff, result = exported(write_mot(recording, tmp_path)), recording.scenario.study.cutoff, rescore(recording).result(0.0)
    near = [similarity(targets, places, cutoff) for _, targets, _, places in frames]
    data = {
        "gt_ids": indexed([frame[0] for frame in frames]),
        "tracker_ids": indexed([frame[2] for frame in frames]),
        "similarity_scores": near,
        "num_gt_dets": sum(len(frame[0]) for frame in frames),
        "num_tracker_dets": sum(len(frame[2]) for frame in frames),
        "num_gt_ids": len({name for frame in frames for name in frame[0]}),
        "num_tracker_ids": len({name for frame in frames for name in frame[2]}),
        "num_timesteps": len(frames),
    }
    quiet = {"PRINT_CONFIG": False}
    clear, identity = metrics.CLEAR(quiet).eval_sequence(data), metrics.Identity(quiet).eval_sequence(data)
    hota = float(np.mean(metrics.HOTA().eval_sequence(data)["HOTA"]))
    assert (result.hota, result.mota) == pytest.approx((hota, float(clear["MOTA"])), abs=1e-9)
    assert result.idf1 == pytest.approx(float(identity["IDF1"]), abs=1e-9) and result.idf1 > 0.3
    assert result.id_switches == int(clear["IDSW"])
    scored = motmetrics.MOTAccumulator(auto_id=True)
    for (ids, _, labels, _), close in zip(frames, near):
        scored.update(ids, labels, np.where(close >= 0.5, 1.0 - close, np.nan))
    other = motmetrics.metrics.create().compute(scored, metrics=["idf1", "mota", "num_switches"]).iloc[0]
    assert (result.idf1, result.mota) == pytest.approx((float(other["idf1"]), float(other["mota"])), abs=1e-9)
    assert result.id_switches == int(other["num_switches"])


def test_geojson_is_valid_and_its_points_lie_where_the_estimates_do(
    recording: Recording, ticks: list[ReportedTick], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    geojson = pytest.importorskip("geojson")
    monkeypatch.setattr(geojson.geometry, "DEFAULT_PRECISION", 9)  # it rounds what it reads to 0.1 m otherwise
    count = write_geojson(recording, earth_of(recording, ORIGIN, BEGAN), tmp_path / "a.geojson")
    found = geojson.loads((tmp_path / "a.geojson").read_text())
    assert found.is_valid and len(found.features) == count
    points = [one for one in found.features if one.properties["kind"] == "estimate"]
    wanted = [(tick, one) for tick in ticks for one in tick.targets]
    assert len(points) == len(wanted)
    for point, (tick, one) in zip(points, wanted):
        place = shapely.geometry.shape(point.geometry)
        assert LocalFrame(*ORIGIN).to_plane(place.y, place.x) == pytest.approx((one.x, one.y), abs=0.02)
        assert point.properties["time"] == f"2016-01-12T13:02:{11.0 + tick.truth.time:06.3f}Z"
        assert point.properties["label"] == one.label
    lines = {(one.properties["kind"], one.properties["name"]): one for one in found.features if one.properties["kind"] != "estimate"}
    assert {name for kind, name in lines if kind == "sensor"} == set(recording.scenario.members)
    assert len([name for kind, name in lines if kind == "target"]) == 3
    assert len(lines["sensor", "s1"].geometry.coordinates) == len(lines["sensor", "s1"].properties["times"]) == 20


def test_events_have_the_form_that_pytak_makes_and_hold_the_places(recording: Recording, ticks: list[ReportedTick], tmp_path: Path) -> None:
    pytak = pytest.importorskip("pytak")
    count = write_cot(recording, earth_of(recording, ORIGIN, BEGAN), tmp_path / "a.cot")
    events = [ElementTree.fromstring(line) for line in (tmp_path / "a.cot").read_text().splitlines()]
    assert len(events) == count == sum(len(tick.targets) + len(tick.truth.alive) for tick in ticks)
    pattern = pytak.gen_cot_xml(lat=50.0, lon=-1.0, uid="x", cot_type="a-u-G", callsign="x")
    for event in events:
        assert {"version", "type", "uid", "how", "time", "start", "stale"} <= set(event.attrib) & set(pattern.attrib)
        assert set(event.find("point").attrib) == set(pattern.find("point").attrib)  # type: ignore[union-attr]
        assert event.find("detail/contact").attrib.keys() <= pattern.find("detail/contact").attrib.keys()  # type: ignore[union-attr]
        assert event.attrib["time"] < event.attrib["stale"]
    targets = [event for event in events if event.attrib["type"] == "a-u-G"]
    frame, wanted = LocalFrame(*ORIGIN), [(one.x, one.y) for tick in ticks for one in tick.targets]
    places = [frame.to_plane(float(event.find("point").attrib["lat"]), float(event.find("point").attrib["lon"])) for event in targets]  # type: ignore[union-attr]
    assert np.array(places) == pytest.approx(np.array(wanted), abs=0.02)


def test_events_beyond_the_date_line_have_longitudes_in_the_west(recording: Recording, tmp_path: Path) -> None:
    """The arena begins at 180 degrees, so that all of it lies beyond."""
    write_cot(recording, earth_of(recording, (10.0, 180.0), BEGAN), tmp_path / "a.cot")
    places = [ElementTree.fromstring(line).find("point").attrib["lon"] for line in (tmp_path / "a.cot").read_text().splitlines()]  # type: ignore[union-attr]
    assert all(-180.0 <= float(place) < -179.99 for place in places) and len(set(places)) > 10


@pytest.mark.parametrize(
    ("form", "origin", "began", "said"),
    [
        ("geojson", None, None, "--origin: is missing; a latitude and a longitude in degrees say where (0, 0) of this arena is"),
        ("cot", (95.0, 1.0), None, "--origin 95 1: should be a latitude within +-89 and a longitude within +-180 degrees"),
        ("cot", ORIGIN, "yesterday", "--began yesterday: should be such as 2016-01-12T13:02:11Z"),
        *(
            (
                form,
                ORIGIN,
                moment,
                f"--began {moment}: should be such that the 4.75 s of the recording lie in the years 1 to 9999, UTC",
            )
            for form, moment in (("geojson", "9999-12-31T23:59:56Z"), ("cot", "0001-01-01T00:00:00+02:00"))
        ),
        ("cot", ORIGIN, None, "--began: is missing; {path} does not say when the run began, as one of a simulation"),
        ("mot", ORIGIN, None, "--origin, --began: are for --to geojson and --to cot, not for --to mot"),
    ],
)
def test_an_export_that_cannot_be_says_which_option_is_wrong(
    recording: Recording, form: str, origin: tuple[float, float] | None, began: str | None, said: str
) -> None:
    with pytest.raises(BadSetting) as error:
        recordings.export(str(recording.path), form, None, origin, began)
    assert str(error.value) == said.format(path=recording.path)


@pytest.mark.parametrize(("clock", "began"), [("realtime", 100.0 - 8.0 / 4.0), ("lockstep", 100.0 - 8.0)])
def test_without_being_told_the_run_began_when_the_time_of_its_first_truth_was_zero(tmp_path: Path, clock: str, began: float) -> None:
    scenario = resolve("quick", {"run.name": "seen", "run.clock": clock, "run.rate": 4.0})
    seconds = iter((40.0, 100.0, 101.0))  # a token is heard long before the first tick
    recorder = Recorder(tmp_path / "a.mcap", scenario, lambda: 1.5e9 + next(seconds))
    recorder.see(Alive("agent", "s1", 1), 0.0)
    for tick in (32, 33):  # it came late
        truth = Truth(sender="world", incarnation=1, tick=tick, time=0.25 * tick)
        recorder.see(received(truth, payloads=[codec.encode(truth)]), 0.0)
    recorder.close()
    assert earth_of(Recording(tmp_path / "a.mcap"), ORIGIN, None).began.timestamp() - 1.5e9 == pytest.approx(began)


def test_a_beginning_with_an_offset_is_told_in_utc(recording: Recording) -> None:
    earth = earth_of(recording, ORIGIN, "2016-01-12T15:02:11+02:00")
    assert earth.moment(0.25) == earth_of(recording, ORIGIN, "2016-01-12T13:02:11").moment(0.25) == "2016-01-12T13:02:11.250Z"


def test_of_two_agents_that_report_one_label_in_a_tick_each_has_a_label_of_its_own_in_every_export(tmp_path: Path) -> None:
    """Of equals the first of the team keeps it, as in the scores and in MOT files."""
    scenario = resolve("quick", {"run.name": "seen", "run.clock": "lockstep", "team.composition": "A10"})
    recorder = Recorder(tmp_path / "a.mcap", scenario, None)
    recorder.see(received(truth := Truth(sender="world", incarnation=1, tick=0, time=0.0), payloads=[codec.encode(truth)]), 0.0)
    for name, place in (("s10", (1.0, 2.0)), ("s2", (7.0, 8.0))):
        said = Estimate(
            sender=name,
            incarnation=1,
            tick=0,
            pose=(0.0, 0.0, 0.0),
            cod=(0.0, 0.0),
            power_radius=1.0,
            unused=1.0,
            targets_bytes=pack(np.array([place]), "<f8"),
            labels_bytes=pack(np.array([5]), "<u8"),
        )
        recorder.see(received(said, payloads=[codec.encode(said)]), 0.0)
    recorder.close()
    [tick] = reported_ticks(Recording(tmp_path / "a.mcap"))
    assert [(one.agent, one.label) for one in tick.targets] == [("s2", 5), ("s10", derived_label(5, 1))]
    recording = Recording(tmp_path / "a.mcap")
    write_cot(recording, earth_of(recording, ORIGIN, BEGAN), tmp_path / "a.cot")
    uids = [ElementTree.fromstring(line).get("uid") for line in (tmp_path / "a.cot").read_text().splitlines()]
    assert len(uids) == len(set(uids)) == 2


def test_of_all_estimates_of_a_recording_an_export_keeps_the_targets_alone(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", resolve("quick", {"run.name": "seen", "run.clock": "lockstep"}), None)
    cell = pack(np.zeros((200, 2)), "<f8")
    for tick in range(200):
        truth = Truth(sender="world", incarnation=1, tick=tick, time=0.25 * tick)
        said = Estimate(
            sender="s1", incarnation=1, tick=tick, pose=(0.0, 0.0, 0.0), cod=(0.0, 0.0), power_radius=1.0, unused=1.0, cell_bytes=cell
        )
        for message in (truth, said):
            recorder.see(received(message, payloads=[codec.encode(message)]), 0.0)
    recorder.close()
    recording = Recording(tmp_path / "a.mcap")
    assert len(list(reported_ticks(recording))) == 200  # all is imported
    gc.collect()
    tracemalloc.start()
    ticks = reported_ticks(recording)
    next(ticks)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 0.7 * 200 * len(cell)


@pytest.mark.parametrize("form", ["csv", "parquet", "foxglove", "rerun", "mot", "geojson", "cot"])
def test_a_recording_is_never_written_over_by_its_export(recording: Recording, tmp_path: Path, form: str) -> None:
    (tmp_path / "a.mcap").write_bytes(recording.path.read_bytes())
    (tmp_path / "b.mcap").symlink_to("a.mcap")
    with pytest.raises(BadSetting, match=r"--out .*b\.mcap: is a recording; name another file"):
        recordings.export(str(tmp_path / "a.mcap"), form, tmp_path / "b.mcap", ORIGIN if form in recordings.ON_EARTH else None)
    with pytest.raises(BadSetting, match=r"--csv .*b\.mcap: is a recording"):
        recordings.score(str(tmp_path / "a.mcap"), tmp_path / "b.mcap", False)
    assert (tmp_path / "a.mcap").read_bytes() == recording.path.read_bytes()


@pytest.mark.parametrize("form", ["mot", "geojson", "cot"])
def test_a_place_that_cannot_be_written_to_is_named(recording: Recording, tmp_path: Path, form: str) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(BadSetting, match=r"--out .*should be a place that can be written to"):
        recordings.export(str(recording.path), form, tmp_path / "file" / "below", *((None, None) if form == "mot" else (ORIGIN, BEGAN)))
