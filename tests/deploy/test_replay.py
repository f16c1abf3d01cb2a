"""A recording on the page: what is played, jumped to and found out about the whole, against the run that was recorded."""

import asyncio
import re
from collections import deque
from pathlib import Path

import msgspec
import pytest

from deploy.cli.recordings import _play
from deploy.faults.faults import Action
from deploy.page.address import Address
from deploy.page.frames import moment
from deploy.page.picture import KEPT_TICKS
from deploy.page.server import PageServer
from deploy.recording.observers import Observers, open_recorder
from deploy.recording.recording import Recording
from deploy.recording.replay import ReplayNode, ReplaySource
from deploy.recording.rescore import rescore
from deploy.scenario import FaultSettings, resolve
from deploy.simulation import Simulation
from protocol.message import Message
from protocol.messages import Command
from protocol.node import Gone, Started, Timer
from protocol.settings import BadSetting


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Simulation, Recording]:
    """A run of 20 s in which s2 dies at 10 s, and its recording."""
    scenario = resolve("quick", {"run.seconds": 20.0})
    simulation = Simulation(msgspec.structs.replace(scenario, faults=(FaultSettings(at=10.0, verb="kill", who="s2"),)))
    path = tmp_path_factory.mktemp("replay") / "a.mcap"
    Observers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
    simulation.run()
    return simulation, Recording(path)


def source(run: tuple[Simulation, Recording], speed: float = 1.0) -> ReplaySource:
    return ReplaySource(run[1], speed)


def test_playing_follows_the_clock_at_the_chosen_speed(run: tuple[Simulation, Recording]) -> None:
    replay = source(run, 4.0)
    replay.advance(0.5)
    assert replay.picture.time == 2.0
    asyncio.run(replay.ask({"speed": 10}))
    replay.advance(0.5)
    assert replay.picture.time == 7.0
    asyncio.run(replay.ask({"play": False}))
    replay.advance(5.0)
    assert replay.picture.time == 7.0


def test_the_end_stops_the_play_and_playing_again_begins_anew(run: tuple[Simulation, Recording]) -> None:
    replay = source(run, 100.0)
    replay.advance(10.0)
    assert (replay.playing, replay.clock) == (False, run[1].seconds)
    asyncio.run(replay.ask({"play": True}))
    assert (replay.playing, replay.clock) == (True, 0.0)


@pytest.mark.parametrize("on_a_page", [True, False])
def test_a_damaged_recording_is_named_in_one_line_on_a_page_and_without(
    run: tuple[Simulation, Recording], tmp_path: Path, caplog: pytest.LogCaptureFixture, on_a_page: bool
) -> None:
    spoilt, offset = bytearray(run[1].path.read_bytes()), run[1].spans[1].offset
    spoilt[offset + 200] ^= 0xFF
    (tmp_path / "a.mcap").write_bytes(spoilt)
    replay = ReplaySource(Recording(tmp_path / "a.mcap"), 100.0)
    named = rf"a\.mcap: the chunk at byte {offset} is damaged"

    async def play() -> None:
        server = PageServer(replay, Address("127.0.0.1", 0, True)) if on_a_page else None
        playing = asyncio.create_task(_play(replay, server, replay._recording, publish=False))
        async with asyncio.timeout(20.0):
            while not playing.done() and not caplog.records:
                await asyncio.sleep(0.01)
        playing.cancel()
        await playing

    with pytest.raises(asyncio.CancelledError if on_a_page else BadSetting, match=None if on_a_page else named):
        asyncio.run(play())
    assert [record.exc_info for record in caplog.records] == [None] * on_a_page
    assert not on_a_page or re.search(named, caplog.text)


@pytest.mark.parametrize("to", [15.0, 3.0, 10.0, 0.0, 19.75])
def test_a_jump_shows_what_playing_up_to_there_would_have_shown(run: tuple[Simulation, Recording], to: float) -> None:
    played, jumped = source(run), source(run)
    played.advance(0.0)
    for replay in (played, jumped):
        replay.scan(60.0)
    played.playing, played.clock = True, 0.0
    played.advance(to)
    jumped.seek(7.0)
    jumped.seek(to)
    one, other = (moment(replay.picture, replay.score()) for replay in (played, jumped))
    for data in (one, other):
        del data["messages"]  # counts what was read
        for agent in data["agents"]:
            if agent["state"] in ("waiting", "dead"):  # a jump does not know what the dead had said, nor under which incarnation
                for name in set(agent) - {"name", "state", "pose"}:
                    del agent[name]
    assert one == other


def test_after_a_jump_the_trails_reach_back_some_ticks_where_ticks_are_long(tmp_path: Path) -> None:
    simulation = Simulation(resolve("quick", {"run.seconds": 120.0, "run.dt": 2.0}))
    Observers(simulation.scorer, open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True))
    simulation.run()
    replay = ReplaySource(Recording(tmp_path / "a.mcap"))
    replay.seek(100.0)
    assert len(replay.picture.trail) == KEPT_TICKS


def test_the_look_through_the_whole_file_finds_the_scores_of_the_run_and_who_was_lost(run: tuple[Simulation, Recording]) -> None:
    replay = source(run)
    assert not replay.is_scanned
    replay.scan(60.0)
    assert replay.is_scanned
    assert list(replay.scores()) == run[0].scorer.scores
    assert [(one.kind, one.who) for one in replay.picture.happenings if one.kind == "lost"] == [("lost", "s2")]
    replay.seek(12.0)
    score = replay.score()
    assert score is not None
    assert score.tick == 47
    assert replay.picture.agents["s2"].state == "dead"


def test_playing_through_a_death_does_not_write_the_time_line_twice(run: tuple[Simulation, Recording]) -> None:
    replay = source(run)
    replay.scan(60.0)
    replay.advance(15.0)
    replay.seek(5.0)
    replay.advance(10.0)
    assert len([one for one in replay.picture.happenings if one.kind == "lost"]) == 1


@pytest.mark.parametrize("ended", [True, False])
def test_agents_that_leave_when_a_run_is_ended_early_have_not_died(tmp_path: Path, ended: bool) -> None:
    """Their tokens and that of the world go in any order. Where the world lives on, they have died."""
    simulation = Simulation(resolve("quick", {"run.seconds": 20.0}))
    recorder = open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True)
    Observers(simulation.scorer, recorder)
    while simulation.scorer.truth is None or simulation.scorer.truth.tick < 8:
        simulation.bus.step()
    simulation.injector.strike(Action("kill", ["s2"]))
    while simulation.scorer.truth.tick < 12:
        simulation.bus.step()
    for event in (Gone("agent", "s1", 1), Gone("world", "world", 1), *(Gone("agent", f"s{number}", 1) for number in (3, 4, 5, 6))):
        if ended or event.role == "agent":
            recorder.see(event, 0.0)
    recorder.close()
    recording = Recording(tmp_path / "a.mcap")
    kills = rescore(recording).result(None).kills
    assert [kill.name for kill in kills] == (["s2"] if ended else ["s2", "s1", "s3", "s4", "s5", "s6"])
    replay = ReplaySource(recording, 100.0)
    replay.advance(10.0)
    assert [known.name for known in replay.picture.agents.values() if known.alive] == (["s1", "s3", "s4", "s5", "s6"] if ended else [])


def test_a_cut_between_agents_and_its_end_stand_on_the_time_line_of_a_replay(tmp_path: Path) -> None:
    faults = (FaultSettings(at=3.0, verb="partition", who="s1,s2", seconds=2.0), FaultSettings(at=4.0, verb="kill", who="s6"))
    simulation = Simulation(msgspec.structs.replace(resolve("quick", {"run.seconds": 8.0}), faults=faults))
    Observers(simulation.scorer, open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True))
    simulation.run()
    replay = ReplaySource(Recording(tmp_path / "a.mcap"))
    replay.scan(60.0)
    told = [(one.kind, one.time, one.text) for one in replay.picture.happenings if one.kind in ("partition", "heal", "lost")]
    assert told == [("partition", 3.0, "cut off s1, s2"), ("lost", 4.0, "s6 is gone"), ("heal", 5.0, "s1, s2: no longer cut off")]


@pytest.mark.parametrize("request_", [{"seek": "x"}, {"seek": -1}, {"speed": 0}, {"speed": True}, {"verb": "kill"}, {}])
def test_senseless_requests_are_refused(run: tuple[Simulation, Recording], request_: dict[str, object]) -> None:
    with pytest.raises(BadSetting):
        asyncio.run(source(run).ask(request_))


def test_what_is_played_is_said_again_message_for_message(run: tuple[Simulation, Recording]) -> None:
    replay = source(run)
    replay.outbox = deque()
    node = ReplayNode("covey", replay.outbox)
    assert node.handle(Started(), 0.0) == []
    replay.advance(2.0)
    said = node.handle(Timer(), 0.05)
    assert len(said) > 100
    assert all(isinstance(effect, Message) for effect in said)
    assert [effect.tick for effect in said if isinstance(effect, Command) and effect.sender == "s1"] == list(range(9))
    assert node.handle(Timer(), 0.1) == []
    replay.seek(15.0)
    assert node.handle(Timer(), 0.15) == [], "the past is not said again after a jump"
    replay.advance(0.5)
    assert {effect.tick for effect in node.handle(Timer(), 0.2) if isinstance(effect, Command)} == {61, 62}


def test_a_cut_recording_is_replayed_as_far_as_it_goes(run: tuple[Simulation, Recording], tmp_path: Path) -> None:
    data = run[1].path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[:-4000])
    replay = ReplaySource(Recording(tmp_path / "cut.mcap"), 100.0)
    replay.scan(60.0)
    replay.advance(10.0)
    assert replay.is_scanned
    assert not replay.playing
