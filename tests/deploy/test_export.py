"""A run in other tools' forms: tables against the run itself, the drawing for Foxglove against its schema, figures that can be opened."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import shapely
from matplotlib.figure import Figure
from mcap.reader import make_reader
from PIL import Image
from pyarrow import csv, parquet

from deploy.cli import figures, recordings
from deploy.plots import method_figures
from deploy.plots.run_figures import Trajectories, write_animation, write_figure
from deploy.recording.foxglove import SCENE_SCHEMA, write_foxglove
from deploy.recording.moments import messages, moments
from deploy.recording.observers import Observers, open_recorder
from deploy.recording.recorder import Recorder
from deploy.recording.recording import Recording, find_recording
from deploy.recording.rerun_file import write_rerun
from deploy.recording.tables import tables, write_tables
from deploy.scenario import FaultSettings, resolve
from deploy.scoring.scorer import Scorer
from deploy.scoring.scores import hole_and_overlap
from deploy.simulation import Simulation
from protocol import codec
from protocol.messages import Gossip, Hello, Message
from protocol.node import received
from protocol.observer_messages import Truth
from protocol.settings import BadSetting

Run = tuple[Simulation, Recording]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of 5 s in which s2 dies at 3 s, and its recording."""
    scenario = resolve("quick", {"run.seconds": 5.0})
    simulation = Simulation(msgspec.structs.replace(scenario, faults=(FaultSettings(at=3.0, verb="kill", who="s2"),)))
    path = tmp_path_factory.mktemp("export") / "recording.mcap"
    Observers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
    simulation.run()
    return simulation, Recording(path)


def test_the_tables_hold_the_scores_and_what_was_said(run: Run) -> None:
    found = tables(run[1])
    scores = run[0].scorer.scores
    assert found["scores"]["ospa"].to_pylist() == [score.ospa for score in scores]
    assert found["scores"]["tick"].to_pylist() == list(range(20))
    assert found["targets"].num_rows == sum(score.targets for score in scores)
    assert found["agents"].num_rows == 6 * 20 - 8  # s2 falls silent with tick 12, in the middle of it
    last = [row for row in found["agents"].to_pylist() if row["tick"] == 19]
    assert sum(row["cell_area"] for row in last) == pytest.approx(625.0)
    assert {row["agent"] for row in last} == {"s1", "s3", "s4", "s5", "s6"}
    rows = found["estimates"].to_pylist()
    assert {0.0 < row["existence"] <= 1.0 and row["xx"] > 0.0 for row in rows} == {True} and any(row["label"] for row in rows)
    assert len({(row["tick"], row["agent"], row["label"]) for row in rows if row["label"]}) == sum(row["label"] != 0 for row in rows)
    assert {row["agent"] for row in found["detections"].to_pylist()} <= {"s1", "s2", "s3", "s4", "s5", "s6"}


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_tables_come_back_from_their_files_with_every_digit(run: Run, tmp_path: Path, form: str) -> None:
    files = {file.stem: file for file in write_tables(run[1], tmp_path / form, form)}
    assert set(files) == {"scores", "agents", "targets", "estimates", "detections"}
    again = csv.read_csv(files["scores"]) if form == "csv" else parquet.read_table(files["scores"])
    assert again["gospa"].to_pylist() == [score.gospa for score in run[0].scorer.scores]


def test_detections_of_a_guest_are_places_though_its_sensor_measures_range_and_bearing(tmp_path: Path) -> None:
    wedge = {"angle": 66.0, "radius": 8.4, "prob_detection": 0.9}
    ranging = {**wedge, "measures": "range-bearing", "range_noise": 0.1, "bearing_noise": 1.0}
    recorder = Recorder(tmp_path / "a.mcap", resolve("quick", {"sensors.R": ranging, "run.name": "seen"}))
    scan = np.array([[4.0, np.pi / 2.0]], dtype=np.float32).tobytes()
    fields: dict[str, Any] = {"cod": (1.0, 2.0), "power_radius": 0.0, "unused": 0.0, "detections_bytes": scan}
    said: list[Message] = [Hello(sender=name, incarnation=1, sensor_class=kind) for name, kind in (("guest", "R"), ("other", "nobody's"))]
    said += [Gossip(sender=name, incarnation=1, tick=0, pose=(1.0, 2.0, np.pi / 2.0), **fields) for name in ("guest", "other")]
    for message in said:
        recorder.see(received(message, payloads=[codec.encode(message)]), 0.0)
    recorder.close()
    rows = {row["agent"]: (row["x"], row["y"]) for row in tables(Recording(tmp_path / "a.mcap"))["detections"].to_pylist()}
    assert rows["guest"] == pytest.approx((-3.0, 2.0), abs=1e-5)
    assert rows["other"] == pytest.approx((4.0, np.pi / 2.0))  # nobody knows what it measures


def test_a_recording_without_anything_in_it_gives_empty_tables(tmp_path: Path) -> None:
    Recorder(tmp_path / "a.mcap", resolve("quick"))
    assert [table.num_rows for table in tables(Recording(tmp_path / "a.mcap")).values()] == [0] * 5
    with pytest.raises(BadSetting, match="nothing was recorded"):
        write_figure(Recording(tmp_path / "a.mcap"), tmp_path)


def fits(data: Any, schema: dict[str, Any]) -> bool:
    """Whether data have just the fields, and the types, of a JSON schema of objects, arrays and plain values."""
    kind = schema["type"]
    if kind == "object":
        return (
            isinstance(data, dict)
            and set(data) == set(schema["properties"])
            and all(fits(data[n], s) for n, s in schema["properties"].items())
        )
    if kind == "array":
        return isinstance(data, list) and all(fits(item, schema["items"]) for item in data)
    plain = {"string": str, "boolean": bool, "integer": int, "number": (int, float)}[kind]
    return isinstance(data, plain) and (kind == "boolean" or not isinstance(data, bool))


def drawn_for_foxglove(file: Path) -> tuple[list[Any], list[Any]]:
    """The scenes and the scores of a drawing."""
    scenes: list[Any] = []
    scores: list[Any] = []
    with file.open("rb") as opened:
        for found, channel, message in make_reader(opened).iter_messages():
            assert found is not None
            assert channel.message_encoding == "json"
            (scenes if found.name == "foxglove.SceneUpdate" else scores).append(json.loads(message.data))
    return scenes, scores


def test_the_drawing_for_foxglove_keeps_to_the_schema_of_scene_updates(run: Run, tmp_path: Path) -> None:
    count = write_foxglove(run[1], tmp_path / "a.foxglove.mcap")
    schema = json.loads(SCENE_SCHEMA.read_text(encoding="utf-8"))
    scenes, scores = drawn_for_foxglove(tmp_path / "a.foxglove.mcap")
    assert len(scenes) == count == 20
    assert all(fits(scene, schema) for scene in scenes)
    assert scores[-1]["ospa"] == run[0].scorer.scores[scores[-1]["tick"]].ospa
    moments = [scene["entities"][0]["timestamp"] for scene in scenes]
    assert [moment["sec"] + 1e-9 * moment["nsec"] for moment in moments] == [score["time"] for score in scores]
    entities = {entity["id"]: entity for entity in scenes[10]["entities"]}
    assert {"arena", "targets", "estimates", "agent s1"} <= set(entities)
    assert len(entities["targets"]["spheres"]) == 3
    assert [gone["id"] for gone in scenes[-1]["deletions"]] == ["agent s2"]


def test_a_drawing_has_the_scores_that_came_late_because_an_agent_was_silent(tmp_path: Path) -> None:
    scenario = resolve("quick", {"run.seconds": 5.0})
    pause = FaultSettings(at=2.0, verb="pause", who="s2", seconds=1.0)
    simulation = Simulation(msgspec.structs.replace(scenario, faults=(pause,)), clock="realtime")
    Observers(simulation.scorer, open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True))
    simulation.run()
    write_foxglove(Recording(tmp_path / "a.mcap"), tmp_path / "a.foxglove.mcap")
    _, scores = drawn_for_foxglove(tmp_path / "a.foxglove.mcap")
    assert [(score["tick"], score["ospa"]) for score in scores] == [(score.tick, score.ospa) for score in simulation.scorer.scores]
    assert len(scores) == 20


def test_the_drawing_for_rerun_holds_every_tick_and_its_scores(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs the extra [rerun]")
    reading = pytest.importorskip("rerun.chunk", reason="needs a Rerun that reads its own files")
    assert write_rerun(run[1], tmp_path / "a.rrd") == 20
    rows: dict[str, dict[float, Any]] = {}
    for chunk in reading.RrdReader(str(tmp_path / "a.rrd")).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if name.endswith((":scalars", ":positions", ":strips", ":text"))]
        if names and "world" in batch.schema.names:
            times = [nanoseconds / 1e9 for nanoseconds in batch.column("world").cast("int64").to_pylist()]
            rows.setdefault(chunk.entity_path, {}).update(zip(times, batch.column(names[0]).to_pylist()))
    ospa = rows["/score/ospa"]
    assert [ospa[time] for time in sorted(ospa)] == [[score.ospa] for score in run[0].scorer.scores]
    truth = next(message for message in messages(run[1]) if isinstance(message, Truth) and message.tick == 7)
    assert np.array(rows["/arena/targets"][7 * 0.25])[:, :2] == pytest.approx(truth.targets, abs=1e-5)
    later = [
        message for message in messages(run[1]) if isinstance(message, Gossip) and message.tick == 8
    ]  # they carry what was owned after 7
    assert len(rows["/arena/particles"][7 * 0.25]) == sum(len(gossip.states) for gossip in later) > 0
    assert len(rows["/arena/cells"][7 * 0.25]) == 6
    assert len(rows["/arena/dead"][18 * 0.25]) == 1
    assert {time: text[:17] for time, (text,) in rows["/happenings"].items()} == {3.0: "s2 is gone", 4.75: "s2 died at 3.0 s:"}


def test_faults_and_what_became_of_them_stand_on_the_time_line_of_a_drawing(tmp_path: Path) -> None:
    faults = (FaultSettings(at=1.0, verb="partition", who="s1,s2", seconds=1.0), FaultSettings(at=2.0, verb="kill", who="s6"))
    simulation = Simulation(msgspec.structs.replace(resolve("quick", {"run.seconds": 6.0}), faults=faults))
    told: list[tuple[float, str]] = []
    simulation.scorer.on_report = lambda one: told.append((one.time, one.text))
    Observers(simulation.scorer, open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True))
    simulation.run()
    *_, last = moments(Recording(tmp_path / "a.mcap"), Scorer(simulation.scenario, recorded=True))
    happened = [(one.kind, one.time, one.text) for one in last.picture.happenings]
    assert ("partition", 1.0, "cut off s1, s2") in happened and ("heal", 2.0, "s1, s2: no longer cut off") in happened
    assert told and [(time, text) for kind, time, text in happened if kind == "told"] == told


def test_a_tick_is_drawn_once_also_beside_those_that_a_world_that_was_restarted_has_left_out(tmp_path: Path) -> None:
    recorder, ticks = open_recorder(tmp_path / "a.mcap", resolve("quick", {}), virtual=True), (0, 1, 2, 3, 5, 6, 7, 8)
    for tick in ticks:
        truth = Truth(sender="world", incarnation=1 if tick < 4 else 2, tick=tick, time=0.25 * tick)
        recorder.see(received(truth, payloads=(codec.encode(truth),)), 0.25 * tick)
    recorder.close()
    recording = Recording(tmp_path / "a.mcap")
    drawn = [moment.truth.time / 0.25 for moment in moments(recording, Scorer(recording.scenario, recorded=True))]
    assert drawn == list(ticks)


def test_without_rerun_its_export_says_what_to_install(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(BadSetting, match="pip install"):
        write_rerun(run[1], tmp_path / "a.rrd")


def test_the_drawing_is_never_taken_for_the_recording(run: Run) -> None:
    write_foxglove(run[1], run[1].path.with_suffix(".foxglove.mcap"))
    assert find_recording(str(run[1].path.parent)) == run[1].path


def test_a_run_is_drawn_tick_by_tick_with_the_estimates_and_the_particles_of_the_tick(run: Run) -> None:
    """The gossip of the next tick carries the particles."""
    ways = Trajectories()
    ticks = []
    for picture, truth in moments(run[1]):
        ways.add(truth)
        ticks.append(truth.tick)
        living = [known for known in picture.agents.values() if known.alive]
        assert {estimate.tick for known in living if (estimate := picture.said(known)[1])} == {truth.tick}
        assert {gossip.tick for known in living if (gossip := picture.outcome(known))} == {min(truth.tick + 1, 19)}
    assert ticks == list(range(20))
    assert {len(way) for way in ways.bodies.values()} == {20}
    assert picture.agents["s1"].alive
    assert not picture.agents["s2"].alive


@pytest.mark.parametrize("every", [1, 3])
def test_the_cells_that_are_drawn_leave_the_hole_that_the_scorer_found_whoever_dies(tmp_path: Path, every: int) -> None:
    given = resolve("quick", {"run.seconds": 5.0, "timing.estimate_every": every})
    faults = tuple(FaultSettings(at=at, verb="kill", who=who) for at, who in ((2.0, "s2"), (3.25, "s3")))
    simulation = Simulation(msgspec.structs.replace(given, faults=faults))
    Observers(simulation.scorer, open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True))
    simulation.run()
    drawn = []
    for picture, _ in moments(Recording(tmp_path / "a.mcap")):
        said = [picture.said(known)[1] for known in picture.agents.values() if picture.is_alive(known)]
        drawn.append(hole_and_overlap([estimate.cell for estimate in said if estimate is not None], 625.0))
    found = [(score.hole, score.overlap) for score in simulation.scorer.scores]
    assert np.array(drawn) == pytest.approx(np.array(found), abs=1e-9)
    assert {8, 13} <= {tick for tick, (hole, _) in enumerate(found) if hole > 0.01}


@pytest.mark.slow
def test_a_figure_is_a_pdf_with_real_fonts_and_a_png(run: Run, tmp_path: Path) -> None:
    pdf, png = write_figure(run[1], tmp_path)
    assert pdf.read_bytes().startswith(b"%PDF")
    assert b"/TrueType" in pdf.read_bytes() or b"/CIDFontType2" in pdf.read_bytes()
    with Image.open(png) as image:
        assert image.size[0] > 2000


@pytest.mark.slow
def test_the_pictures_of_the_method_are_of_the_tick_before_the_first_death(run: Run, tmp_path: Path) -> None:
    names = [file.stem for file in method_figures.write_figures(run[1], tmp_path)]
    assert names == ["footprints", "cod", "power-cells", "unused-capacity", "goal", "claim", "copies", "round", "death"]
    moments = method_figures.seen_agents_by_tick(run[1])
    assert [sum(seen.alive for seen in moment.values()) for moment in moments] == [6] * 12 + [5] * 8  # s2 falls silent with tick 12
    areas = [sum(shapely.Polygon(seen.estimate.cell).area for seen in moment.values() if seen.alive) for moment in moments]
    assert areas[11] == pytest.approx(625.0) and areas[12] < 624.0 and areas[13] == pytest.approx(625.0)  # the hole is drawn, and its end


def test_the_footprints_are_those_of_the_scenario() -> None:
    def figure(**settings: object) -> Figure:
        return method_figures.footprints_figure(resolve("quick", settings))

    def titles(figure: Figure) -> list[str]:
        return [title for axes in figure.axes if (title := axes.get_title())]

    paper = titles(figure())
    assert len(paper) == 8 and paper[0] == "A: 240°, 8 m, p_d 0.99"
    falling = {"angle": 120.0, "radius": 14.0, "scale": 9.0, "peak": 0.98}
    own = {"sensors.A.radius": 12.0, "sensors.Z.model": "covey.examples.sensors:RangeFalling", "sensors.Z.parameters": falling}
    assert titles(figure(**own)) == ["A: 240°, 12 m, p_d 0.99", paper[1], "Z: reach 14 m, 205 m²"]
    small = figure(**{"sensors.L.radius": 2.0, "sensors.L.angle": 90.0, "team.composition": "6L"})
    assert len(titles(small)) == 1 and small.axes[0].get_xlim() == (-2.0, 2.0)


@pytest.mark.slow
def test_a_moving_picture_has_a_frame_for_every_half_second(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)  # as where there is no ffmpeg
    told: list[tuple[int, int]] = []
    file = write_animation(run[1], tmp_path, lambda done, ticks: told.append((done, ticks)))
    assert told == [(done, 20) for done in range(1, 20, 2)]
    with Image.open(file) as image:
        assert (file.suffix, image.n_frames) == (".gif", 10)  # type: ignore[attr-defined]


def test_a_moving_picture_of_a_recording_of_one_odd_tick_has_a_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    recorder = open_recorder(tmp_path / "a.mcap", resolve("quick", {}), virtual=True)
    truth = Truth(sender="world", incarnation=1, tick=31, time=7.75)
    recorder.see(received(truth, payloads=(codec.encode(truth),)), 7.75)
    recorder.close()
    with Image.open(write_animation(Recording(tmp_path / "a.mcap"), tmp_path)) as image:
        assert getattr(image, "n_frames", 1) == 1


def test_an_ffmpeg_that_fails_is_one_line_and_leaves_no_film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ffmpeg").write_text("#!/bin/sh\necho tried >&2\necho no encoder for h264 >&2\nexit 1\n")
    (tmp_path / "ffmpeg").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    recorder = open_recorder(tmp_path / "a.mcap", resolve("quick", {}), virtual=True)
    truth = Truth(sender="world", incarnation=1, tick=0, time=0.0)
    recorder.see(received(truth, payloads=(codec.encode(truth),)), 0.0)
    recorder.close()
    with pytest.raises(BadSetting, match=r"run\.mp4: ffmpeg cannot write it: no encoder for h264; without an ffmpeg in PATH it is a GIF$"):
        write_animation(Recording(tmp_path / "a.mcap"), tmp_path / "film")
    assert list((tmp_path / "film").iterdir()) == []


@pytest.mark.slow
def test_a_moving_picture_of_a_run_that_was_ended_early_is_of_its_own_ticks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    simulation = Simulation(resolve("quick", {"run.seconds": 10_000.0}))
    recorder = open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True)
    simulation.scorer.on_event = recorder.see
    while simulation.scorer.truth is None or simulation.scorer.truth.tick < 19:
        simulation.bus.step()
    recorder.close()
    with Image.open(write_animation(Recording(tmp_path / "a.mcap"), tmp_path)) as image:
        assert image.n_frames >= 9  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("option", "command"),
    [
        ("--out", lambda file, place: recordings.export(file, "csv", place)),
        ("--out", lambda file, place: recordings.export(file, "foxglove", place)),
        ("--into", lambda file, place: figures.draw_run(file, place, False, False)),
        ("--csv", lambda file, place: recordings.score(file, place, False)),
    ],
)
def test_a_place_that_cannot_be_written_to_is_named(run: Run, tmp_path: Path, option: str, command: Callable[[str, Path], int]) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(BadSetting, match=f"{option} .*should be a place that can be written to"):
        command(str(run[1].path), tmp_path / "file" / "below")
