"""The agent as a node: what goes in, what comes out, and when."""

import math

import msgspec
import numpy as np
import pytest

from agents.agent import Agent
from agents.config import AgentConfig, ControlSettings, FilterSettings, TimingSettings
from agents.coverage.control import ControlInput, Situation
from agents.membership.announcements import EARLY_CROWD, EARLY_PERIOD, REPLY_DELAY
from agents.membership.membership import EXIT_FENCED
from agents.round_alone import unsent_gossip
from protocol.fields import pack
from protocol.measuring import MeasurementModel
from protocol.message import Message
from protocol.messages import Beacon, Command, Gossip, Hello, Observation
from protocol.node import NO_EFFECTS, Alive, Effect, Event, Gone, Received, Rejected, Started, Stop, Subscribe, Timer, Warn, received
from protocol.observer_messages import Estimate
from protocol.sensing import SENSOR_CLASSES, Pose, WedgeSensor
from protocol.settings import ArenaSettings, BadSetting, LimitSettings, RunSettings, SensorSettings
from protocol.settings_digest import settings_digest

CONFIG = AgentConfig(
    run=RunSettings(dt=0.5, rate=2.0),
    arena=ArenaSettings(width=40.0, height=40.0),
    members={"s1": "A", "s2": "B"},
)
LOCKSTEP = AgentConfig(run=RunSettings(dt=0.5, clock="lockstep", patience=5.0), arena=CONFIG.arena, members={"s1": "A", "s2": "B"})


def see(tick: int, incarnation: int = 1) -> Received:
    return received(
        Observation(sender="world", incarnation=incarnation, recipient="s1", tick=tick, time=0.5 * tick, pose=(10.0, 20.0, 0.0))
    )


def word(tick: int, sender: str = "s2", incarnation: int = 1, **fields: object) -> Received:
    usual: dict[str, object] = {"pose": (30.0, 20.0, 0.0), "cod": (32.0, 20.0), "power_radius": 2.0, "unused": 20.0}
    return received(Gossip(sender=sender, incarnation=incarnation, tick=tick, **{**usual, **fields}))  # type: ignore[arg-type]


def hello(sender: str = "s2", incarnation: int = 1, **fields: object) -> Received:
    usual: dict[str, object] = {"sensor_class": "B", "sensor": SENSOR_CLASSES["B"]}
    return received(Hello(sender=sender, incarnation=incarnation, **{**usual, **fields}))  # type: ignore[arg-type]


def kinds(effects: list[Effect]) -> list[type]:
    return [type(effect) for effect in effects]


def only(effects: list[Effect], kind: type[Message]) -> Message:
    found = [effect for effect in effects if isinstance(effect, kind)]
    assert len(found) == 1
    return found[0]


def met(config: AgentConfig = CONFIG) -> Agent:
    """s1, which knows that s2 is alive and what its sensor is."""
    agent = Agent(config, "s1", incarnation=1)
    agent.handle(Started(), 0.0)
    agent.handle(Alive("agent", "s2", 1), 0.0)
    agent.handle(hello(), 0.0)
    return agent


class East:
    """A law that wants to go east as fast as it can."""

    def command(self, situation: Situation) -> ControlInput:
        return (2.0, 0.0), 0.0


@pytest.mark.parametrize(("pace", "ticks"), [(1, 1), (4, 4)])
def test_at_a_slower_pace_bodies_keep_apart_for_as_long_as_a_command_lasts(pace: int, ticks: int) -> None:
    """A body 2 m ahead: each may go 1 m less radius and clearance in twice the time between two commands.

    In a tick without gossips the body is where the proximity sensor says, and no more where the last gossip said.
    """
    law, limits = ControlSettings(mode=f"{__name__}:East"), LimitSettings(radius=0.5)
    config = AgentConfig(run=RunSettings(dt=0.25), arena=CONFIG.arena, members=CONFIG.members, control=law, limits=limits)
    agent = met(config)
    for tick in (0, 4):
        agent.handle(see(tick), 1.0 + 0.25 * tick)
        command = only(agent.handle(word(tick, pose=(12.0, 20.0, 0.0), cod=(14.0, 20.0), pace=pace), 1.0 + 0.25 * tick), Command)
    assert isinstance(command, Command)
    assert command.velocity == pytest.approx(((1.0 - 0.5 - 0.05) / (2.0 * ticks * 0.25), 0.0))
    agent.handle(Timer(), 2.01)  # which shows that nothing keeps its driver busy
    [alone] = [effect for effect in agent.handle(see(5), 2.25) if isinstance(effect, Command)] if pace > 1 else [None]
    assert alone is None or alone.velocity == (2.0, 0.0)


def test_it_subscribes_to_greetings_gossip_and_its_own_observations_and_greets() -> None:
    effects = Agent(CONFIG, "s1").handle(Started(), 0.0)
    assert [effect.expression for effect in effects if isinstance(effect, Subscribe)] == [
        "covey/covey/hello/*",
        "covey/covey/gossip/*",
        "covey/covey/observation/s1",
    ]
    greeting = only(effects, Hello)
    assert isinstance(greeting, Hello) and greeting.sensor == SENSOR_CLASSES["A"] and greeting.heard == ()


def test_an_observation_is_answered_at_once_and_the_round_closes_with_the_last_word() -> None:
    agent = met()
    effects = agent.handle(see(0), 1.0)
    said = only(effects, Gossip)
    assert isinstance(said, Gossip) and said.tick == 0 and said.pose == (10.0, 20.0, 0.0) and not said.listening
    assert math.isclose(said.power_radius, 6.4992, abs_tol=1e-3)  # Table I, class A: nothing is used yet
    assert kinds(agent.handle(word(0), 1.1)) == [Estimate, Command]


def test_a_tick_in_which_the_sensor_did_not_scan_is_said_as_such_and_is_none_for_an_agent_that_plays_alone() -> None:
    agent = met()
    [blank] = see(0).batch.messages
    assert isinstance(blank, Observation)
    blank = msgspec.structs.replace(blank, scanned=False)
    said = only(agent.handle(received(blank), 1.0), Gossip)
    assert isinstance(said, Gossip) and not said.scanned
    assert not unsent_gossip(agent.context, agent.outcome, blank, None).scanned


def test_a_word_that_came_before_the_observation_counts() -> None:
    agent = met()
    assert agent.handle(word(0), 0.9) == []
    assert kinds(agent.handle(see(0), 1.0)) == [Gossip, Estimate, Command]


def test_alone_it_closes_at_once_and_owns_the_arena() -> None:
    agent = Agent(CONFIG, "s1")
    estimate = only(agent.handle(see(0), 0.0), Estimate)
    assert isinstance(estimate, Estimate)
    assert sorted(map(tuple, estimate.cell.tolist())) == [(0.0, 0.0), (0.0, 40.0), (40.0, 0.0), (40.0, 40.0)]
    # The prior less what the empty scan of class A has ruled out, D = 132.7 m^2; the particles are a random sample of it.
    assert math.isclose(estimate.mass, 0.001 * (1600.0 - 132.7), rel_tol=0.05)


def test_in_real_time_the_deadline_is_a_share_of_the_period() -> None:
    agent = met()
    agent.handle(see(0), 1.0)
    assert agent.deadline() == pytest.approx(REPLY_DELAY) or agent.deadline() == pytest.approx(1.125)
    agent.handle(Timer(), 1.0)  # the greeting
    assert agent.deadline() == pytest.approx(1.0 + 0.5 * 0.5 / 2.0)
    effects = agent.handle(Timer(), 1.125)
    assert kinds(effects) == [Estimate, Command]
    assert agent.counters["late"] == 1 and agent.counters["missing"] == 1


def test_in_lockstep_it_is_patient_but_less_so_with_whom_it_has_missed_before() -> None:
    agent = met(LOCKSTEP)
    agent.handle(word(0), 0.3)
    agent.handle(see(0), 0.4)
    agent.handle(see(1), 10.0)
    first = agent._close_at
    agent.handle(Timer(), 100.0)
    agent.handle(see(2), 100.0)
    second = agent._close_at
    assert first is not None and second is not None
    assert 1.0 < first - 10.0 <= 5.0 and 0.0 < second - 100.0 <= 0.5


def test_the_loss_of_the_token_of_the_last_missing_peer_closes_the_round() -> None:
    agent = met()
    agent.handle(see(0), 1.0)
    assert kinds(agent.handle(Gone("agent", "s2", 1), 1.01)) == [Estimate, Command]
    assert agent.outcome.belief.mine.claim.names == ("s1",)


def test_a_dead_peer_is_no_generator_until_it_speaks_of_a_later_tick() -> None:
    agent = met()
    agent.handle(word(0), 0.9)
    agent.handle(see(0), 1.0)
    assert agent.outcome.belief.mine.claim.names == ("s1", "s2")
    agent.handle(Gone("agent", "s2", 1), 1.1)
    agent.handle(see(1), 1.2)
    assert agent.outcome.belief.mine.claim.names == ("s1",)
    agent.handle(word(2), 1.3)
    agent.handle(see(2), 1.4)
    assert agent.outcome.belief.mine.claim.names == ("s1", "s2")


def test_a_new_observation_closes_the_round_that_is_open_and_gaps_are_counted() -> None:
    agent = met()
    agent.handle(see(0), 1.0)
    effects = agent.handle(see(3), 1.5)
    assert kinds(effects) == [Estimate, Command, Gossip, Estimate, Command]
    assert [effect.tick for effect in effects if isinstance(effect, Command)] == [0, 3]
    assert agent.counters["skipped"] == 2


def test_an_old_observation_and_an_old_world_change_nothing() -> None:
    agent = met()
    agent.handle(see(5, incarnation=2), 1.0)
    assert agent.handle(see(5, incarnation=2), 1.1) == [] and agent.handle(see(4, incarnation=2), 1.1) == []
    assert agent.handle(see(9, incarnation=1), 1.1) == []
    assert agent.counters["rejected.old_observation"] == 3 and agent.tick == 5


@pytest.mark.parametrize("goes_first", [True, False])
@pytest.mark.parametrize("shows", [Alive("agent", "s2", 900), hello(incarnation=900)])
def test_a_peer_that_restarts_with_an_earlier_clock_is_named_once_with_the_remedy(goes_first: bool, shows: Event) -> None:
    agent = Agent(CONFIG, "s1")
    agent.handle(Alive("agent", "s2", 1000), 0.0)
    first = [] if goes_first else agent.handle(shows, 0.1)
    agent.handle(Gone("agent", "s2", 1000), 0.2)
    said = [*agent.handle(shows, 0.3), *agent.handle(shows, 0.4)]
    warnings = [effect.text for effect in said if isinstance(effect, Warn)]
    assert not any(isinstance(effect, Warn) for effect in first)  # an older process that is about to end
    assert len(warnings) == 1 and "s2 is refused: its incarnation 900 is smaller than 1000" in warnings[0]
    assert warnings[0].endswith("--incarnation 1001")


@pytest.mark.parametrize(("kind", "radius"), [("gaussian-mixture", 10.0), ("particles", 1.0e6)])
def test_a_peer_whose_sensor_cannot_be_used_is_refused_and_ends_nobody(kind: str, radius: float) -> None:
    """A sensor of bearings alone: a mixture has no use for it, and a beam of 1000 km would need a grid of that size."""
    agent = Agent(msgspec.structs.replace(CONFIG, filter=FilterSettings(kind=kind)), "s1")  # type: ignore[arg-type]
    agent.handle(Started(), 0.0)
    agent.handle(Alive("agent", "s2", 1), 0.0)
    agent.handle(hello(sensor=WedgeSensor(1.0, radius, 0.9, MeasurementModel("bearing", 0.01))), 0.0)
    for tick in range(3):
        agent.handle(see(tick), 0.25 * tick)
        agent.handle(word(tick, detections_bytes=pack(np.array([[0.0, 0.3]]), "<f4")), 0.25 * tick + 0.05)
        agent.handle(Timer(), 0.25 * tick + 0.2)
    assert agent.counters["rounds"] == 3 and agent.counters["rejected.sensor"] == 1 and agent.counters["rejected.unknown_sensor"] == 3


class Blind:
    """A square that sees nothing."""

    reach, area = 6.0, 72.0

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        return np.zeros(len(points))

    def footprint(self, pose: Pose) -> np.ndarray:
        return np.array([[6.0, 0.0], [0.0, 6.0], [-6.0, 0.0], [0.0, -6.0]])


def test_an_announced_class_that_sees_nothing_is_refused_and_ends_nobody() -> None:
    """Without `covey check` nobody has tried the class, and its name alone stands in a Hello."""
    config = msgspec.structs.replace(CONFIG, sensors={"X": SensorSettings(model=f"{__name__}:Blind")})
    agent = Agent(config, "s1")
    [warning] = [effect for _ in range(2) for effect in agent.handle(hello(sensor=None, sensor_class="X"), 0.0)]
    assert isinstance(warning, Warn) and warning.text.startswith(
        "s2 is refused: its sensor cannot be used here: tests.agents.test_agent:Blind"
    )
    assert agent.counters == {"rejected.sensor": 2}
    with pytest.raises(BadSetting, match=r"^sensors\.X: tests\.agents\.test_agent:Blind: the detection probability is 0 everywhere"):
        Agent(config, "s1", sensor_class="X")


def test_a_known_peer_that_says_other_settings_while_all_is_calm_is_named_once() -> None:
    agent = met()
    agent.handle(see(0), 0.5)
    agent.handle(word(0), 0.5)
    other = hello(settings={"filter": {"speed": 9.0}})
    said = [*agent.handle(hello(), 0.6), *agent.handle(other, 0.7), *agent.handle(other, 0.8)]
    consequence = "it computes another PHD and is refused"
    assert [each for each in said if isinstance(each, Warn)] == [
        Warn(f"the settings of s2 differ from those of s1 in filter.speed: {consequence}")
    ]
    assert agent.counters["rejected.settings"] == 2


def test_gossips_are_held_back_only_where_nobody_measures_how_late_they_come() -> None:
    late = msgspec.structs.replace(CONFIG, timing=TimingSettings(look_ahead=1.0))
    assert Agent(CONFIG, "s1").coalesced_keys == "/gossip/" and Agent(late, "s1").coalesced_keys == ""


def test_a_newcomer_listens_until_it_has_heard_everybody() -> None:
    agent = met()
    said = only(agent.handle(see(7), 1.0), Gossip)
    assert isinstance(said, Gossip) and said.listening and said.claim_names == ()
    effects = agent.handle(word(7), 1.1)
    estimate = only(effects, Estimate)
    assert isinstance(estimate, Estimate) and len(estimate.cell) == 0
    said = only(agent.handle(see(8), 1.5), Gossip)
    assert isinstance(said, Gossip) and not said.listening


def test_a_newcomer_that_hears_nobody_waits_before_it_believes_to_be_alone() -> None:
    agent = Agent(CONFIG, "s1")
    listening = []
    for tick in range(3, 15):
        said = only(agent.handle(see(tick), 0.25 * tick), Gossip)
        agent.handle(Timer(), 0.25 * tick)
        assert isinstance(said, Gossip)
        listening.append(said.listening)
    assert listening == [True] * 8 + [False] * 4


def test_the_older_of_two_processes_with_one_name_leaves() -> None:
    for younger in (Alive("agent", "s1", 2), hello("s1", 2), word(0, "s1", 2)):
        effects = Agent(CONFIG, "s1", incarnation=1).handle(younger, 0.0)
        assert [effect.code for effect in effects if isinstance(effect, Stop)] == [EXIT_FENCED]
        assert not any(isinstance(effect, Stop) for effect in Agent(CONFIG, "s1", incarnation=2).handle(younger, 0.0))


def test_the_word_of_a_stranger_of_an_old_incarnation_and_beyond_its_sensor_is_refused() -> None:
    agent = met()
    agent.handle(word(0, "s9"), 0.1)
    agent.handle(word(0, incarnation=0), 0.1)
    agent.handle(word(0, power_radius=50.0), 0.1)
    agent.handle(word(0, unused=30.0), 0.1)
    agent.handle(word(0, cod=(39.0, 20.0)), 0.1)
    assert agent.counters == {"rejected.unknown_sensor": 1, "rejected.incarnation": 1, "rejected.implausible": 3}


def test_a_greeting_with_a_sensor_that_nobody_knows_is_refused_and_ends_nothing() -> None:
    agent = Agent(CONFIG, "s1")
    [warning] = agent.handle(hello("s3", sensor=None, sensor_class="Z"), 0.0)
    assert isinstance(warning, Warn) and "s3 is refused: its sensor cannot be used here: sensor class 'Z' does not exist" in warning.text
    assert agent.counters["rejected.sensor"] == 1


def test_it_greets_once_for_all_who_appear_within_a_moment_and_the_rarer_the_more_they_are() -> None:
    agent = Agent(CONFIG, "s1")
    agent.handle(Started(), 0.0)
    for number in range(2, 30):
        assert agent.handle(Alive("agent", f"s{number}", 1), 0.01) == []
    assert agent.deadline() == pytest.approx(0.01 + REPLY_DELAY)
    greeting = only(agent.handle(Timer(), 0.01 + REPLY_DELAY), Hello)
    assert isinstance(greeting, Hello)
    assert agent.deadline() == pytest.approx(0.01 + REPLY_DELAY + EARLY_PERIOD * 28 / EARLY_CROWD)


def test_while_the_team_gathers_only_the_rhythm_and_the_last_to_come_make_it_greet() -> None:
    team = AgentConfig(members={f"s{number}": "A" for number in range(1, 25)})
    agent = Agent(team, "s1")
    agent.handle(Started(), 0.0)
    for number in range(2, 24):
        agent.handle(Alive("agent", f"s{number}", 1), 0.01)
    assert agent.deadline() == pytest.approx(EARLY_PERIOD * 23 / EARLY_CROWD)
    agent.handle(Alive("agent", "s24", 1), 0.02)
    assert agent.deadline() == pytest.approx(0.02 + REPLY_DELAY)
    late = Agent(team, "s1")
    late.handle(Started(), 0.0)
    late.handle(word(7), 0.01)
    late.handle(Alive("agent", "s2", 1), 0.02)
    assert late.deadline() == pytest.approx(0.02 + REPLY_DELAY), "the run goes on: others wait for nobody"


def test_who_hears_its_neighbours_only_answers_the_world_at_once_however_large_the_team() -> None:
    team = AgentConfig(members={f"s{number}": "A" for number in range(1, 97)}, timing=TimingSettings(interest="neighbours"))
    agent = Agent(team, "s1")
    agent.handle(Started(), 0.0)
    agent.handle(received(Hello(sender="world", incarnation=1, role="world")), 0.01)
    assert agent.deadline() == pytest.approx(0.01 + REPLY_DELAY)
    agent.handle(Timer(), 0.01 + REPLY_DELAY)
    assert agent.deadline() == pytest.approx(0.01 + REPLY_DELAY + EARLY_PERIOD)


def test_the_hello_of_a_restarted_world_is_answered_at_once() -> None:
    agent = Agent(CONFIG, "s1")
    agent.handle(Started(), 0.0)
    world = {"sender": "world", "role": "world"}
    agent.handle(received(Hello(incarnation=1, **world)), 0.0)  # type: ignore[arg-type]
    agent.handle(see(0), 0.1)
    for moment in (0.3, 0.6):
        agent.handle(Timer(), moment)  # the Hellos that were due anyway
    agent.handle(received(Hello(incarnation=1, **world)), 1.0)  # type: ignore[arg-type]
    assert (agent.deadline() or 9.0) > 1.0 + REPLY_DELAY  # the world at hand needs no answer
    effects = agent.handle(received(Hello(incarnation=2, **world)), 1.0)  # type: ignore[arg-type]
    assert effects is not NO_EFFECTS  # which would say that the deadline is what it was
    assert agent.deadline() == pytest.approx(1.0 + REPLY_DELAY)
    assert Hello in kinds(agent.handle(Timer(), 1.0 + REPLY_DELAY))


def test_rejected_bytes_are_counted_by_reason_and_foreign_kinds_are_ignored() -> None:
    agent = Agent(CONFIG, "s1")
    agent.handle(Rejected("s2", "format"), 0.0)
    agent.handle(Rejected("s2", "format"), 0.0)
    beacon = Beacon(sender="s2", incarnation=1, tick=0, position=(0.0, 0.0), cod=(0.0, 0.0), power_radius=0.0, reach=1.0, column=0, row=0)
    assert agent.handle(received(beacon), 0.0) == []
    assert agent.counters == {"rejected.format": 2}


def test_a_control_law_that_does_not_exist_is_told_at_the_start() -> None:
    with pytest.raises(BadSetting, match=r"control\.mode = 'lloyds': known are lloyd"):
        Agent(AgentConfig(members={"s1": "A"}, control=ControlSettings(mode="lloyds")), "s1")


def test_an_impossible_word_does_not_raise_the_dead() -> None:
    agent = met()
    agent.handle(word(0), 0.9)
    agent.handle(see(0), 1.0)
    agent.handle(Gone("agent", "s2", 1), 1.1)
    agent.handle(word(1, unused=30.0), 1.2)
    agent.handle(see(1), 1.3)
    assert agent.outcome.belief.mine.claim.names == ("s1",)


def test_somebody_with_other_settings_is_named_once_counted_each_time_and_still_heard() -> None:
    agent = met()
    other = {"settings": {**CONFIG.shared_settings(), "filter": {"gate": 1.5}, "arena": {"width": 2.5}}}
    effects = agent.handle(hello("s7", **other), 0.1)
    text = "the settings of s7 differ from those of s1 in arena.width, filter.gate: it computes another PHD and is refused"
    assert effects == [Warn(text)] and agent.handle(hello("s7", **other), 0.2) == []
    assert agent.counters["rejected.settings"] == 2
    assert [type(effect) for effect in agent.handle(hello("s7", incarnation=2, **other), 0.3)] == [Warn]  # a process of its own
    due = agent.deadline()
    assert due is not None
    assert "s7" in only(agent.handle(Timer(), due), Hello).heard  # type: ignore[attr-defined]


def test_a_world_of_another_arena_is_a_warning() -> None:
    agent = Agent(CONFIG, "s1")
    agent.handle(Started(), 0.0)
    world = Hello(sender="world", incarnation=1, role="world", settings={"arena": {"height": 1}})
    assert agent.handle(received(world), 0.1) == [Warn("the settings of world differ from those of s1 in arena.height")]
    assert agent.handle(see(0), 0.2)


def test_a_beacon_of_other_settings_is_refused() -> None:
    config = msgspec.structs.replace(CONFIG, timing=TimingSettings(interest="neighbours"))
    agent, right = Agent(config, "s1"), settings_digest(config.shared_settings())
    seen = Beacon(
        sender="s2",
        incarnation=1,
        tick=0,
        position=(1.0, 1.0),
        cod=(2.0, 1.0),
        power_radius=1.0,
        reach=8.0,
        column=0,
        row=0,
        sensor_class="B",
    )
    for settings, known in [(right ^ 2, set()), (0, {"s2"}), (right, {"s2", "s3"})]:
        agent.handle(received(msgspec.structs.replace(seen, sender="s3" if settings == right else "s2", settings=settings)), 0.1)
        assert agent.peer_table.peers.keys() == known
    assert agent.counters["rejected.settings"] == 1


def test_a_gossip_of_a_tick_far_ahead_says_nothing_about_the_lag() -> None:
    agent, lags = met(msgspec.structs.replace(CONFIG, timing=TimingSettings(look_ahead=2.5))), []
    agent.handle(word(2**40, lag=5), 1.0)
    for tick in range(12):
        agent.handle(see(tick), 1.0 + 0.25 * tick)
        agent.handle(word(tick), 1.0 + 0.25 * tick)
        agent.handle(Timer(), 1.24 + 0.25 * tick)
        lags.append(agent._rounds.lag.current)
    assert set(lags) == {0}
