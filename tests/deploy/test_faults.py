"""Who is meant, and when it happens."""

import math

import msgspec
import pytest

from deploy.cli.scenario_checks import faults_beyond_a_simulation, faults_on_links, faults_that_are_waited_for
from deploy.faults.faults import REFUSED, Action, Schedule, check_fault, check_faults, choose
from deploy.scenario import FaultSettings, resolve
from deploy.simulation import Simulation
from protocol.random_streams import stream
from protocol.settings import BadSetting

TEAM = [f"s{number}" for number in range(1, 17)]


def test_names_are_taken_as_they_stand() -> None:
    assert choose("s3, s1", TEAM[:2], TEAM, stream(1, "t")) == ["s3", "s1"]


@pytest.mark.parametrize(("who", "number"), [("4", 4), ("0", 0), ("30%", 5), ("1%", 1), ("0%", 0), ("100%", 16), ("12.5 %", 2)])
def test_a_number_or_a_share_is_drawn_from_the_candidates_without_repetition(who: str, number: int) -> None:
    chosen = choose(who, TEAM, TEAM, stream(1, "t"))
    assert len(chosen) == len(set(chosen)) == number
    assert set(chosen) <= set(TEAM)


def test_the_same_dice_choose_the_same_and_other_dice_others() -> None:
    draws = [choose("4", TEAM, TEAM, stream(seed, "faults", 0)) for seed in (1, 1, 2, 3, 4)]
    assert draws[0] == draws[1]
    assert len({tuple(draw) for draw in draws}) > 1


@pytest.mark.parametrize(
    ("who", "complaint"),
    [
        ("s99", "s99.*no such process.*s1"),
        ("", "should be a name such as s3"),
        ("s1,,s2", "who = 's1,,s2': should be a name such as s3, .* or names with a comma between two"),
        ("s1,s2,s1", "who = 's1,s2,s1': names s1 twice"),
        ("17", "only 16"),
        ("120%", "at most 100%"),
        ("-3", "no such process"),
    ],
)
def test_whoever_cannot_be_meant_is_refused_in_one_line(who: str, complaint: str) -> None:
    with pytest.raises(BadSetting, match=complaint) as caught:
        choose(who, TEAM, TEAM, stream(1, "t"))
    assert "\n" not in str(caught.value)


def test_an_agent_that_is_called_by_a_number_is_meant_before_so_many_agents() -> None:
    assert choose("2", ["1", "2", "3"], ["1", "2", "3"], stream(1, "t")) == ["2"]
    assert len(choose("2", TEAM, TEAM, stream(1, "t"))) == 2


def test_a_share_of_nobody_is_nobody() -> None:
    assert choose("50%", [], TEAM, stream(1, "t")) == []


def test_faults_come_once_each_in_the_order_of_their_time_and_those_with_an_end_are_undone() -> None:
    faults = (
        FaultSettings(at=20.0, verb="kill", who="s1"),
        FaultSettings(at=10.0, verb="pause", who="s2,s3", seconds=5.0),
        FaultSettings(at=12.0, verb="kill", who="s4", seconds=100.0),
    )
    schedule = Schedule(1, faults)
    heard = {time: schedule.due(float(time), TEAM, [], TEAM) for time in range(120)}
    assert {time: actions for time, actions in heard.items() if actions} == {
        10: [Action("pause", ["s2", "s3"])],
        12: [Action("kill", ["s4"])],
        15: [Action("resume", ["s2", "s3"])],
        20: [Action("kill", ["s1"])],
        112: [Action("restart", ["s4"])],
    }


def test_a_fault_that_too_few_agents_qualify_for_is_refused_once_and_the_others_come() -> None:
    schedule = Schedule(1, (FaultSettings(at=1.0, verb="kill", who="4"), FaultSettings(at=1.0, verb="pause", who="s1", seconds=1.0)))
    heard = [schedule.due(float(time), TEAM[:2], [], TEAM) for time in range(4)]
    assert heard[1] == [Action(REFUSED, [], None, {"why": "faults[0].who = '4': only 2 agents qualify"}), Action("pause", ["s1"])]
    assert (heard[0], heard[2], heard[3]) == ([], [Action("resume", ["s1"])], [])


def test_a_random_restart_is_drawn_from_the_dead_and_everything_else_from_the_living() -> None:
    schedule = Schedule(3, (FaultSettings(at=1.0, verb="restart", who="2"), FaultSettings(at=2.0, verb="kill", who="100%")))
    assert schedule.due(1.0, TEAM[4:], TEAM[:2], TEAM) == [Action("restart", TEAM[:2])]
    assert schedule.due(2.0, TEAM[4:], TEAM[:2], TEAM) == [Action("kill", TEAM[4:])]


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        (FaultSettings(at=1.0, verb="explode", who="s1"), r"faults\[0\]\.verb = 'explode'.*kill"),
        (FaultSettings(at=1.0, verb="kill", who="s77"), r"faults\[0\]\.who = 's77'"),
    ],
)
def test_a_fault_that_nobody_can_carry_out_is_refused_before_the_run(fault: FaultSettings, complaint: str) -> None:
    with pytest.raises(BadSetting, match=complaint):
        check_faults([fault], TEAM)


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        (FaultSettings(at=1.0, verb="drop"), r"value is missing: drop needs a share"),
        (FaultSettings(at=1.0, verb="loss", value=1.5), r"value = 1\.5: should be a share"),
        (FaultSettings(at=1.0, verb="delay"), r"value is missing: delay needs a number of seconds"),
        (FaultSettings(at=1.0, verb="partition", who="s1", options={"kind": "three"}), r"options\.kind = 'three'.*bridge"),
        (
            FaultSettings(at=1.0, verb="drop", value=0.1, options={"bursts": 3}),
            r"options\.bursts: drop has no such option; known are burst",
        ),
        (FaultSettings(at=1.0, verb="drop", value=0.1, options={"burst": "3"}), r"options\.burst = '3': should be a number"),
        (FaultSettings(at=1.0, verb="join"), r"options\.class is missing"),
        (FaultSettings(at=1.0, verb="partition"), r"who is missing: should be a name"),
        (
            FaultSettings(at=1.0, verb="jump", who="1", value=9.0, seconds=5.0),
            r"seconds = 5: should be left out for jump; only kill, .*slow",
        ),
        (FaultSettings(at=1.0, verb="kill", who="s1", value=0.5), r"value = 0\.5: should be left out for kill; only drop, "),
        (FaultSettings(at=1.0, verb="join", who="s2", options={"class": "A"}), r"who = 's2': there is a process of this name"),
        (
            FaultSettings(at=1.0, verb="freeze", who="s1", value=1.0),
            r"who = 's1': should be left out for freeze, which stops all processes",
        ),
        (FaultSettings(at=1.0, verb="heal", who="s1"), r"who = 's1': should be left out for heal, .* options.only_cut = true"),
        (FaultSettings(at=1.0, verb="slow", who="world", value=1.0), r"who = 'world': there is no such process"),
        (FaultSettings(at=1.0, verb="join", who="world", options={"class": "A"}), r"who = 'world': there is a process of this name"),
        (FaultSettings(at=1.0, verb="heal", seconds=0.0), r"seconds = 0: should be left out for heal"),
    ],
)
def test_a_fault_that_says_too_little_or_too_much_is_refused_by_field(fault: FaultSettings, complaint: str) -> None:
    with pytest.raises(BadSetting, match=r"faults\[0\]\." + complaint):
        check_faults([fault], TEAM, ["world"])


def test_a_newcomer_can_be_struck_by_name_once_it_has_come() -> None:
    join = FaultSettings(at=2.0, verb="join", options={"class": "A"})
    check_faults([FaultSettings(at=3.0, verb="kill", who="guest1"), join], TEAM)
    with pytest.raises(BadSetting, match=r"faults\[0\]\.who = 'guest1': there is no such process"):
        check_faults([FaultSettings(at=1.0, verb="kill", who="guest1"), join], TEAM)


def test_where_bodies_are_processes_of_their_own_nobody_joins() -> None:
    join = FaultSettings(at=2.0, verb="join", options={"class": "A"})
    with pytest.raises(BadSetting, match=r"faults\[0\]\.verb = 'join': should be left out, or bodies\.host be 'world'"):
        check_faults([join], TEAM, [f"{name}.body" for name in TEAM])


def test_of_many_processes_the_first_are_named() -> None:
    with pytest.raises(BadSetting, match=r"known are s1, .* s12 and 89 more, a number such as 4"):
        check_faults([FaultSettings(at=1.0, verb="kill", who="x")], [f"s{number}" for number in range(1, 101)], ["world"])


def test_a_freeze_is_of_all_and_needs_nobody_by_name() -> None:
    freeze = FaultSettings(at=1.0, verb="freeze", value=2.0)
    check_faults([freeze], TEAM)
    assert Schedule(1, [freeze]).due(1.0, TEAM[:2], [], TEAM) == [Action("freeze", TEAM[:2], 2.0)]


def test_live_there_are_no_newcomers_or_jumping_clocks_and_link_faults_must_be_allowed() -> None:
    drop = FaultSettings(at=1.0, verb="drop", value=0.1)
    check_faults([drop], TEAM, live=True, link_faults=True)
    with pytest.raises(BadSetting, match=r"network\.link_faults = true"):
        check_faults([drop], TEAM, live=True, link_faults=False)
    with pytest.raises(BadSetting, match="works in a simulation only"):
        check_faults([FaultSettings(at=1.0, verb="jump", who="1", value=9.0)], TEAM, live=True)


@pytest.mark.parametrize("value", [-0.5, 2e9, math.nan, math.inf])
def test_what_no_link_can_do_is_refused_of_orders_by_hand_too(value: float) -> None:
    """They are no part of a scenario, whose values are checked when it is read."""
    for verb in ("drop", "delay"):
        with pytest.raises(BadSetting, match=r"value = .*: should be "):
            check_fault(FaultSettings(at=0.0, verb=verb, value=value), "", TEAM, TEAM, live=True, link_faults=True)
    with pytest.raises(BadSetting, match=r"options\.jitter = .*: should be a number from 0 to 1e\+09"):
        check_fault(FaultSettings(at=0.0, verb="delay", value=0.1, options={"jitter": value}), "", TEAM, TEAM, live=True, link_faults=True)


def test_link_faults_end_with_a_share_of_zero_and_a_partition_heals() -> None:
    faults = (FaultSettings(at=1.0, verb="loss", value=0.2, seconds=2.0), FaultSettings(at=2.0, verb="partition", who="s1", seconds=2.0))
    schedule = Schedule(1, faults)
    heard = [schedule.due(float(time), TEAM[:2], [], TEAM) for time in range(5)]
    assert heard[1] == [Action("drop", TEAM[:2], 0.2)] and heard[3] == [Action("drop", TEAM[:2], 0.0)]
    assert heard[2] == [Action("partition", ["s1"])] and heard[4] == [Action("heal", ["s1"], None, {"only_cut": True})]


def test_faults_that_change_nothing_here_are_said_in_a_line() -> None:
    faults = tuple(FaultSettings(at=1.0, verb=verb, who="s1", value=0.5) for verb in ("slow", "delay", "loss", "kill"))
    scenario = msgspec.structs.replace(resolve("quick"), faults=faults)
    line = "without --rate 1 rounds of a simulation wait up to 2.5 s for what is late, so these may change nothing: delay, slow"
    assert faults_that_are_waited_for(scenario) == line
    assert faults_on_links(scenario) == "real processes need network.link_faults = true for delay, drop"
    linked = msgspec.structs.replace(scenario, network=msgspec.structs.replace(scenario.network, link_faults=True))
    assert faults_on_links(linked) == faults_that_are_waited_for(resolve("quick")) == faults_on_links(resolve("quick")) == ""
    dead_world = msgspec.structs.replace(scenario, faults=(FaultSettings(at=1.0, verb="kill", who="s1,world"),))
    assert faults_beyond_a_simulation(dead_world) == "a simulation has no such process to strike: world"
    assert faults_beyond_a_simulation(scenario) == ""


def test_rounds_in_lockstep_wait_for_what_is_late_as_long_as_the_remark_says() -> None:
    def transcript(delay: float) -> str:
        scenario = resolve("quick", {"run.seconds": 1.0})
        return Simulation(msgspec.structs.replace(scenario, faults=(FaultSettings(at=0.0, verb="delay", value=delay),))).run().transcript

    assert transcript(0.0) == transcript(2.4) != transcript(2.6)
