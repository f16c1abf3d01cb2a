"""Files that a run, a score or an export leaves: each is whole, or as it was before."""

import asyncio
import errno
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from deploy.live.control import ControlServer
from deploy.recording.mot import write_mot
from deploy.recording.observers import Observers, open_recorder
from deploy.recording.recording import Recording
from deploy.recording.tables import write_tables
from deploy.recording.trace import Trace
from deploy.scenario import resolve
from deploy.scoring.scores import write_scores
from deploy.simulation import Simulation
from deploy.storage.run_directory import RunDirectory
from protocol.whole_file import whole_file, write_whole

Played = tuple[Simulation, Trace, Recording]


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    folder = tmp_path_factory.mktemp("run")
    simulation = Simulation(resolve("quick", {"run.seconds": 2.0}))
    Observers(simulation.scorer, open_recorder(folder / "a.mcap", simulation.scenario, virtual=True))
    simulation.run()
    return simulation, Trace(simulation), Recording(folder / "a.mcap")


async def listen(folder: Path) -> None:
    server = ControlServer(RunDirectory("one"), lambda request: {})  # type: ignore[arg-type, return-value]
    try:
        await server.open()
    finally:
        await server.close()


def write_study_table(file: Path) -> None:
    pytest.importorskip("matplotlib")
    from deploy.plots.study_figures import write_table

    write_table(file, ["team", "ospa"], [["1", 0.5]])
    assert file.read_text() == "team,ospa\n1,0.5\n"


def draw(file: Path, recording: Recording) -> None:
    pytest.importorskip("matplotlib")
    from deploy.plots import method_figures, run_figures

    draws = {"trajectories": run_figures.write_figure, "run": run_figures.write_animation, "cod": method_figures.write_figures}
    draws[file.stem](recording, file.parent)


def draw_study(file: Path) -> None:
    pytest.importorskip("matplotlib")
    from deploy.plots import study_figures

    row: dict[str, object] = {"scenario": "efficacy", "team": "2", "triple": "ACD", "agents": 24, "start_targets": 30, "seed": 1}
    study_figures.draw([{**row, "method": "power", "steady_ospa": 1.0, "control": "lloyd"}], file.parent)


WRITERS: dict[str, Callable[[Path, Played], object]] = {
    "scores.csv": lambda file, run: write_scores(file, run[0].scorer.scores),
    "trace.csv": lambda file, run: run[1].write(file, run[0].result()),
    "trace.npz": lambda file, run: run[1].write(file, run[0].result()),
    "trace.parquet": lambda file, run: run[1].write(file, run[0].result()),
    "targets.csv": lambda file, run: write_tables(run[2], file.parent, "csv"),
    "targets.parquet": lambda file, run: write_tables(run[2], file.parent, "parquet"),
    "ablation.csv": lambda file, run: write_study_table(file),
    "figure4.pdf": lambda file, run: draw_study(file),
    "trajectories.pdf": lambda file, run: draw(file, run[2]),
    f"run.{'mp4' if shutil.which('ffmpeg') else 'gif'}": lambda file, run: draw(file, run[2]),
    "cod.png": lambda file, run: draw(file, run[2]),
    "seqinfo.ini": lambda file, run: write_mot(run[2], file.parent),
    "run.toml": lambda file, run: RunDirectory("one").write_config(run[0].scenario),
    "agents.toml": lambda file, run: RunDirectory("one").write_config(run[0].scenario),
    "versions.json": lambda file, run: RunDirectory("one").write_config(run[0].scenario),
    "control.json": lambda file, run: asyncio.run(listen(file.parent)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_is_seen_whole_or_as_it_was(name: str, played: Played, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    (tmp_path / "one").mkdir()
    file = tmp_path / "one" / name
    file.write_text("before")
    seen, replace = [], Path.replace

    def look(new: Path, place: Path) -> Path:
        if place == file:
            seen.append((file.read_text(), new.stat().st_size > 0))
        return replace(new, place)

    monkeypatch.setattr(Path, "replace", look)
    WRITERS[name](file, played)
    assert seen == [("before", True)]


def test_what_could_not_be_written_leaves_the_former_file_and_nothing_beside_it(tmp_path: Path) -> None:
    write_whole(tmp_path / "a.json", b"before")
    with pytest.raises(OSError, match="full"), whole_file(tmp_path / "a.json") as new:
        new.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "full")
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [("a.json", b"before")]


def test_what_is_no_file_is_written_to_itself() -> None:
    with whole_file(Path("/dev/null")) as new:
        assert new == Path("/dev/null")


def test_a_link_stays_a_link_and_a_new_file_may_be_read_by_those_who_read_the_former(tmp_path: Path) -> None:
    file, link = tmp_path / "a.json", tmp_path / "link.json"
    write_whole(file, b"before")
    file.chmod(0o640)
    write_whole(file, b"after")
    link.symlink_to(file)
    write_whole(link, b"by the link")
    assert link.is_symlink() and file.read_bytes() == b"by the link" and file.stat().st_mode & 0o777 == 0o640
