"""`score`, `export` and `replay`: commands on recordings."""

import asyncio
import contextlib
import logging
import os
import shutil
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from rich.console import Console

from deploy.cli.display import result_table
from deploy.cli.errors import OK, complain, writing
from deploy.cli.terminal import stop_event
from deploy.installation import need_study_packages
from deploy.page.address import address_of
from deploy.recording.recording import NO_END, Recording, find_recording
from deploy.recording.replay import SPEEDS, ReplayNode, ReplaySource
from deploy.recording.rescore import difference, rescore
from deploy.scoring.scores import write_scores
from deploy.storage.kept_runs import DRAWING, new_run_directory
from protocol.endpoints import free_port
from protocol.live import Driver
from protocol.settings import BadSetting, NetworkSettings
from protocol.whole_file import whole_file

if TYPE_CHECKING:
    from deploy.page.server import PageServer

ON_EARTH = ("geojson", "cot")  # forms of an export that lie on Earth


def score(name: str, csv: Path | None, as_json: bool) -> int:
    """Score a recording, and compare with the result of the run itself where that exists."""
    recording = _recording_beside(name, "--csv", csv)
    console = Console(stderr=as_json, highlight=False, markup=False)
    scorer = rescore(recording)
    result = scorer.result(recording.wall_seconds)
    if csv is not None:  # first, as the reader of the table may go
        with writing("--csv", csv):
            write_scores(csv, scorer.scores)
    console.print(result_table(result, f"{recording.path}: {result.scenario}, seed {result.seed}, {result.agents} agents"))
    apart = difference(recording.path, result)
    if apart is not None:
        console.print(f"largest difference to the figures of the run itself: {apart:.3g}")
    if csv is not None:
        console.print(f"{len(scorer.scores)} ticks in {csv}")
    if as_json:
        print(result.to_json())
    return 0


def export(name: str, form: str, out: Path | None, origin: tuple[float, float] | None = None, began: str | None = None) -> int:
    """Write a recording in the form of other tools. `origin` and `began`: where and when it was, for forms that lie on Earth."""
    if form in ON_EARTH:
        return _export_on_earth(_recording_beside(name, "--out", out), form, out, origin, began)
    if origin is not None or began is not None:
        raise BadSetting(f"--origin, --began: are for --to {' and --to '.join(ON_EARTH)}, not for --to {form}")
    if form == "mot":
        return _export_mot(_recording_beside(name, "--out", out), out)
    need_study_packages("export")
    from deploy.recording.foxglove import write_foxglove
    from deploy.recording.tables import write_tables  # these load slowly

    recording = _recording_beside(name, "--out", out)
    if form == "rerun":
        from deploy.recording.rerun_file import write_rerun

        file = out or recording.path.with_suffix(".rrd")
        with writing("--out", file), whole_file(file) as new:
            ticks = write_rerun(recording, new)
        print(f"{ticks} ticks in {file}; look at it with: rerun {file}")
        return 0
    if form == "foxglove":
        file = out or recording.path.with_suffix(DRAWING)
        with writing("--out", file), whole_file(file) as new:
            scenes = write_foxglove(recording, new)
        print(f"{scenes} scenes in {file}")
        return 0
    folder = out or recording.path.parent / form
    with writing("--out", folder):
        files = write_tables(recording, folder, form)
    print("\n".join(map(str, files)))
    return 0


def _recording_beside(name: str, option: str, out: Path | None) -> Recording:
    """The recording that is meant; raises BadSetting where `out` would be written in its place, or in that of another one."""
    if out is not None and out.is_file() and (out.samefile(find_recording(name)) or _is_recording(out)):
        raise BadSetting(f"{option} {out}: is a recording; name another file")
    return open_recording(name)


def open_recording(name: str) -> Recording:
    """The recording that is meant. One without an end is read as far as it goes, and the user is told."""
    recording = Recording(find_recording(name))
    if not recording.is_whole:
        complain(f"{recording.path}: it {NO_END}; what it had written counts", OK)
    return recording


def _is_recording(path: Path) -> bool:
    try:
        Recording(path)
    except BadSetting:
        return False
    return True


def _export_mot(recording: Recording, out: Path | None) -> int:
    """Write the folder of the MOT challenge."""
    from deploy.recording.mot import write_mot

    folder = out or recording.path.parent / "mot"
    with writing("--out", folder):
        files = write_mot(recording, folder)
    print("\n".join(map(str, files)))
    return 0


def _export_on_earth(recording: Recording, form: str, out: Path | None, origin: tuple[float, float] | None, began: str | None) -> int:
    """Write GeoJSON or Cursor-on-Target."""
    from deploy.recording.geographic import earth_of, write_cot, write_geojson

    earth, file = earth_of(recording, origin, began), out or recording.path.with_suffix(f".{form}")
    with writing("--out", file), whole_file(file) as new:
        number = write_geojson(recording, earth, new) if form == "geojson" else write_cot(recording, earth, new)
    print(f"{number} {'features' if form == 'geojson' else 'events'} in {file}")
    return 0


def replay(name: str, page: bool | str, speed: float, publish: bool) -> int:
    """Play a recording on the page, and on Zenoh too if asked, until Ctrl-C."""
    from deploy.page.server import PageServer

    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise BadSetting(f"--speed {speed:g}: should be a number from {SPEEDS[0]:g} to {SPEEDS[1]:g}")
    if page is False and not publish:
        raise BadSetting("--no-page: should come with --publish, or nothing is shown")
    recording = open_recording(name)
    source, address = ReplaySource(recording, speed), address_of(page)
    server = PageServer(source, address) if address else None
    if server:
        print(f"page: {server.bind()}", flush=True)
    print(f"{recording.path}: {recording.scenario.run.scenario}, {recording.seconds:g} s; Ctrl-C ends it", flush=True)
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_play(source, server, recording, publish))
    return 0


async def _play(source: ReplaySource, server: "PageServer | None", recording: Recording, publish: bool) -> None:
    over = stop_event()
    playing = None if server else asyncio.create_task(source.run_while_shown())
    if playing:
        playing.add_done_callback(lambda task: over.set())  # only an error ends it
    if server:
        await server.open()
    try:
        if publish:
            await _say_again(source, recording, over)
        else:
            await over.wait()
    finally:
        if server:
            await server.close()
        if playing:
            playing.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await playing


async def _say_again(source: ReplaySource, recording: Recording, over: asyncio.Event) -> None:
    """Publish the played messages under the same keys, as a run with its own directory that `echo`, `hz`, `ls` and `watch --page` find."""
    directory, lock = new_run_directory(f"{recording.run[:48]}-replay", recording.scenario.run.scenario)
    try:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        recorded = recording.scenario.network  # may have certificates or a router, which are not here
        network = NetworkSettings(listen=(endpoint,), lease=recorded.lease, most_per_second=recorded.most_per_second)
        found = msgspec.structs.replace(network, listen=NetworkSettings().listen, seeds=(endpoint,))
        directory.write_config(msgspec.structs.replace(recording.scenario, network=found), replayed=True)
        source.outbox = deque(maxlen=100_000)
        driver = Driver(ReplayNode(recording.run, source.outbox), network)
        await driver.open()
        print(f"said again as run {directory.name}: covey echo 'estimate/*' --run {directory.name}", flush=True)
        serving, ending = asyncio.create_task(driver.serve()), asyncio.create_task(over.wait())
        await asyncio.wait((serving, ending), return_when=asyncio.FIRST_COMPLETED)
        ending.cancel()
        driver.stop(0, "the replay is over")
        await serving
    finally:
        shutil.rmtree(directory.path, ignore_errors=True)  # other commands found the run by it; it holds no results
        os.close(lock)
