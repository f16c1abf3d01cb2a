"""Whom an agent listens to as others come near and go away: who is needed no longer still comes for a while."""

import msgspec
import pytest

from agents.agent import Agent
from agents.config import AgentConfig, TimingSettings
from agents.coverage.control import STAND
from agents.interest.manager import (
    ANSWER_SECONDS,
    DELAY_FACTOR,
    FORGET_PERIODS,
    LINGER_SECONDS,
    LONGEST_WAIT,
    REPEATED_QUESTIONS,
    InterestManager,
)
from agents.interest.position_table import SENSOR_X, beacon_row
from agents.interest.selection import BEACON_JUMP, BEACON_PERIOD
from agents.interest.tiles import Rectangle
from agents.membership.peer_table import PeerTable
from protocol.geometry import rectangle
from protocol.keys import one_of, tokens_of
from protocol.messages import Beacon, Gossip, Observation
from protocol.node import Effect, Subscribe, Unsubscribe
from protocol.settings import ArenaSettings, RunSettings

CONFIG = AgentConfig(
    members={"s1": "A", "s2": "A", "s3": "A"},
    arena=ArenaSettings(width=200.0, height=200.0),
    timing=TimingSettings(interest="neighbours", tile=18.0),
    run=RunSettings(dt=1.0),
)
GOSSIP, TOKEN = one_of(CONFIG.run.name, "gossip", "s2"), tokens_of(CONFIG.run.name, "agent", "s2")
HOME = rectangle(20.0, 20.0)
SEEN = Observation(sender="world", incarnation=1, recipient="s1", tick=0, time=0.0, pose=(10.0, 10.0, 0.0))


def beacon(name: str, tick: int, x: float) -> Beacon:
    place = x, 10.0
    return Beacon(
        sender=name, incarnation=1, tick=tick, position=place, cod=place, power_radius=2.0, reach=5.0, column=0, row=0, sensor_class="A"
    )


def lookout() -> InterestManager:
    """Of s1, who stands at (10, 10) m and has asked who is there; s3, between him and s2, owns all that is far."""
    agent = Agent(CONFIG, "s1")
    made = InterestManager(agent.context, PeerTable(CONFIG, "s1"))
    made.start(SEEN, agent.outcome, 0.0)
    return made


def standing(name: str, tick: int) -> Gossip:
    return Gossip(sender=name, incarnation=1, tick=tick, pose=(10.0, 10.0, 0.0), cod=(10.0, 10.0), power_radius=2.0, unused=1.0)


def about_s2(effects: list[Effect]) -> list[Effect]:
    return [effect for effect in effects if isinstance(effect, Subscribe | Unsubscribe) and effect.expression in (GOSSIP, TOKEN)]


def look(watcher: InterestManager, tick: int, x: float) -> list[Effect]:
    """What follows for s2 from a choice, when it says that it is at (x, 10) m."""
    watcher.take_beacon(beacon("s2", tick, x))
    watcher.take_beacon(beacon("s3", tick, 60.0))
    return about_s2(watcher.reselect(HOME, beacon("s1", tick, 10.0), tick))


def test_a_beacon_of_a_peer_that_was_given_up_is_a_return() -> None:
    peers = PeerTable(CONFIG, "s1")
    assert peers.take_beacon(beacon("s2", 0, 30.0))
    assert not peers.take_beacon(beacon("s2", 1, 30.0))
    peers.peers["s2"].silent_rounds, peers.selection_outdated = CONFIG.ticks_of_silence, False
    assert peers.take_beacon(beacon("s2", 9, 30.0))
    assert (peers.peers["s2"].silent_rounds, peers.selection_outdated) == (0, True)


def test_a_question_of_a_known_peer_is_answered_and_states_its_position() -> None:
    watcher = lookout()
    assert watcher.take_beacons([beacon("s2", 0, 30.0)]) and not watcher.take_beacons([beacon("s2", 1, 31.0)])
    assert watcher.take_beacons([msgspec.structs.replace(beacon("s2", 2, 32.0), asks=True), beacon("s2", 3, 33.0)])
    table = watcher._peer_table.positions.table(beacon_row(beacon("s1", 3, 10.0), "power"))
    assert table[0, SENSOR_X] == 33.0


def test_how_far_the_widest_sensor_reaches_is_passed_on_from_beacon_to_beacon() -> None:
    watcher = lookout()
    watcher.take_beacons([beacon("s2", 0, 30.0)])
    watcher.take_beacons([msgspec.structs.replace(beacon("s2", 1, 30.0), widest_reach=25.0, widest_offset=7.0, widest_radius=20.0)])
    said = [effect for effect in watcher.answer() if isinstance(effect, Beacon)]
    assert [(one.widest_reach, one.widest_offset, one.widest_radius) for one in said] == [(25.0, 7.0, 20.0)]


@pytest.mark.parametrize("field", ["widest_reach", "widest_offset", "widest_radius"])
def test_a_beacon_is_due_at_once_when_a_larger_agent_gets_known(field: str) -> None:
    watcher, outcome = lookout(), Agent(CONFIG, "s1").outcome

    def beacons(tick: int) -> list[Beacon]:
        return [effect for effect in watcher.close_round(standing("s1", tick), outcome, STAND) if isinstance(effect, Beacon)]

    quiet = next(tick for tick in range(1, int(BEACON_PERIOD)) if not beacons(tick))
    watcher.take_beacons([msgspec.structs.replace(beacon("s2", 0, 30.0), **{field: 50.0})])
    assert [getattr(one, field) for one in beacons(quiet)] == [50.0]


def test_an_announced_sensor_counts_though_its_beacon_says_nothing_of_others() -> None:
    watcher = lookout()
    watcher.take_beacon(msgspec.structs.replace(beacon("s2", 0, 30.0), sensor_class="D"))
    [said] = watcher.answer()
    assert isinstance(said, Beacon) and said.widest_reach == 25.0


def test_a_peer_may_have_gone_as_far_as_brings_no_beacon_and_a_tick_of_its_way() -> None:
    config = msgspec.structs.replace(CONFIG, run=RunSettings(dt=0.5))
    made = InterestManager(Agent(config, "s1").context, PeerTable(config, "s1"))
    assert made._ground.drift == BEACON_JUMP + 0.5 * config.limits.speed


def test_who_goes_and_comes_back_is_listened_to_all_the_while() -> None:
    watcher = lookout()
    assert look(watcher, 0, 30.0) == [Subscribe(GOSSIP), Subscribe(TOKEN)]
    assert [look(watcher, 1 + tick, 190.0) for tick in range(int(LINGER_SECONDS) - 1)] == [[]] * (int(LINGER_SECONDS) - 1)
    assert look(watcher, int(LINGER_SECONDS), 30.0) == []


def test_who_stays_away_is_dropped_and_its_token_when_it_is_forgotten() -> None:
    watcher = lookout()
    look(watcher, 0, 30.0)
    said = [look(watcher, tick, 190.0) for tick in range(1, 10)]
    assert said[int(LINGER_SECONDS) - 1] == [Unsubscribe(GOSSIP)] and sum(map(len, said)) == 1
    assert look(watcher, 10, 30.0) == [Subscribe(GOSSIP)]
    silent = 11 + int(FORGET_PERIODS * BEACON_PERIOD)
    watcher.take_beacon(beacon("s3", silent, 60.0))
    assert about_s2(watcher.reselect(HOME, beacon("s1", silent, 10.0), silent)) == [Unsubscribe(GOSSIP), Unsubscribe(TOKEN)]


@pytest.mark.parametrize(
    ("late", "pause"), [(0.0, ANSWER_SECONDS), (0.02, ANSWER_SECONDS), (0.3, DELAY_FACTOR * 0.3), (60.0, LONGEST_WAIT)]
)
def test_who_is_called_late_gives_the_others_more_time_for_their_answers(late: float, pause: float) -> None:
    watcher = lookout()
    assert watcher.due == ANSWER_SECONDS
    watcher.on_timer(SEEN, Agent(CONFIG, "s1").outcome, ANSWER_SECONDS + late)
    assert watcher.due == pytest.approx(ANSWER_SECONDS + late + pause)


def test_who_hears_nobody_asks_again_nearby_before_it_looks_farther() -> None:
    watcher, outcome = lookout(), Agent(CONFIG, "s1").outcome
    said: list[list[Effect]] = []
    for _ in range(REPEATED_QUESTIONS + 1):
        assert watcher.due is not None
        said.append(watcher.on_timer(SEEN, outcome, watcher.due))
    assert [[type(effect) for effect in effects] for effects in said[:REPEATED_QUESTIONS]] == [[Beacon]] * REPEATED_QUESTIONS
    assert any(isinstance(effect, Subscribe) for effect in said[REPEATED_QUESTIONS])  # the arena is larger than what it listens to
    neighbour = lookout()
    neighbour.take_beacon(beacon("s2", 0, 30.0))
    assert neighbour.due is not None
    assert any(isinstance(effect, Subscribe) for effect in neighbour.on_timer(SEEN, outcome, neighbour.due))


@pytest.mark.parametrize("name", ["s1", "s2", "s3"])
def test_at_a_slower_pace_too_each_period_brings_a_beacon(name: str) -> None:
    agent = Agent(CONFIG, name)
    made, pace = InterestManager(agent.context, PeerTable(CONFIG, name)), int(BEACON_PERIOD)
    made.start(SEEN, agent.outcome, 0.0)
    said = [made.close_round(standing(name, tick), agent.outcome, STAND) for tick in range(pace, 9 * pace, pace)]
    assert [sum(isinstance(effect, Beacon) for effect in effects) for effects in said] == [1] * 8


@pytest.mark.parametrize("listening", [True, False])
def test_a_newcomer_hears_all_around_the_cell_that_it_is_about_to_get(listening: bool) -> None:
    watcher, outcome = lookout(), Agent(CONFIG, "s1").outcome
    watcher.take_beacon(beacon("s2", 0, 150.0))
    assert not len(outcome.cell)
    watcher.close_round(msgspec.structs.replace(standing("s1", 1), listening=listening), outcome, STAND)
    assert ("s2" in watcher._peer_table.interest_set) == listening


def settled() -> InterestManager:
    """Of s1, who knows s2 and s3 and has listened to all the tiles that it needs for some periods."""
    watcher = lookout()
    for tick in range(3 * int(BEACON_PERIOD)):
        look(watcher, tick, 30.0)
    return watcher


def test_a_newcomer_is_answered_who_should_have_been_heard_of_before() -> None:
    """He may not know me either, unless he has just entered the ground that I know."""
    watcher, now = settled(), 3 * int(BEACON_PERIOD)
    edge = max(box.east for box in [watcher.known_area] if box is not None)
    for name, x, answered in (("s4", 20.0, True), ("s5", edge - BEACON_JUMP - 0.5, False), ("s6", edge + 1.0, False), ("s4", 21.0, False)):
        assert watcher.take_beacon(beacon(name, now, x)) == answered
    assert watcher.take_beacon(msgspec.structs.replace(beacon("s7", now, edge + 1.0), asks=True))


def test_while_little_is_known_whoever_is_new_is_answered() -> None:
    assert lookout().take_beacon(beacon("s2", 0, 30.0))


def test_new_ground_is_known_after_a_period_though_more_has_been_added_since() -> None:
    watcher, now, period = settled(), 3 * int(BEACON_PERIOD), int(BEACON_PERIOD)
    east = [box.east for step in range(period + 2) for box in [grown(watcher, step, now + step)]]
    assert east[: period + 1] == [east[0]] * (period + 1)
    assert east[0] < east[period + 1] < float("inf")


def grown(watcher: InterestManager, step: int, tick: int) -> Rectangle:
    """The ground that is known after a choice for a cell that is 18 m wider, one tile, in each step."""
    watcher.reselect(rectangle(56.0 + 18.0 * step, 20.0), beacon("s1", tick, 10.0), tick)
    assert watcher.known_area is not None
    return watcher.known_area
