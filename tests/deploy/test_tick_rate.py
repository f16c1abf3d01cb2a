"""The pace: ticks a second against what was asked, rounds that were left out, and one line of advice where it helps."""

import os
from typing import Any

import msgspec
import pytest

from deploy.cli.display import tick_rate_words
from deploy.scenario import Scenario, resolve
from deploy.scoring.status import TickRate
from deploy.scoring.tick_rate import TickRateMeter, asked_per_s, too_small
from protocol.observer_messages import Estimate


def scenario(**run: Any) -> Scenario:
    return resolve("quick", {"run.dt": 0.25, **{f"run.{field}": value for field, value in run.items()}})


def told(name: str, incarnation: int, counters: dict[str, int], pace: int = 1) -> Estimate:
    fields = {"tick": 0, "pose": (0.0, 0.0, 0.0), "cod": (0.0, 0.0), "power_radius": 0.0, "unused": 0.0}
    return Estimate(sender=name, incarnation=incarnation, counters=counters, pace=pace, **fields)  # type: ignore[arg-type]


def run_at(pace: TickRateMeter, per_second: float, seconds: float, skipped: int = 0, rounds: int = 100) -> None:
    for tick in range(int(per_second * seconds) + 1):
        pace.tick(100.0 + tick / per_second, tick)
    pace.count(told("s1", 1, {"rounds": rounds, "skipped": skipped, "late": 3}))


def test_what_is_asked_is_the_rate_of_real_time_or_the_pace_of_lockstep() -> None:
    assert asked_per_s(scenario(clock="realtime", rate=2.0)) == 8.0
    assert asked_per_s(scenario(clock="lockstep", max_rate=2.5)) == 10.0
    assert asked_per_s(scenario(clock="lockstep")) is None


def test_the_speed_is_that_of_the_last_seconds_and_that_of_the_whole_run() -> None:
    pace = TickRateMeter(scenario(clock="lockstep"))
    assert pace.at(100.0).ticks_per_s is None
    run_at(pace, 10.0, 10.0)
    for tick in range(1, 101):
        pace.tick(110.0 + tick / 20.0, 100 + tick)
    assert pace.at(115.0).ticks_per_s == pytest.approx(20.0)
    assert pace.whole().ticks_per_s == pytest.approx(200.0 / 15.0)


def test_the_rate_falls_when_no_tick_comes_and_stays_while_slow_ticks_come_on_time() -> None:
    still = TickRateMeter(scenario(clock="realtime", rate=2.0))
    run_at(still, 8.0, 10.0)
    rates = [still.at(110.0 + seconds).ticks_per_s for seconds in (0.0, 0.125, 1.0, 5.0, 20.0)]
    assert rates == pytest.approx([8.0, 8.0, 33 / 5, 1 / 5, 1 / 20])
    assert still.at(130.0).advice == ""  # a world that stands still says nothing about the machine
    assert still.whole().ticks_per_s == 8.0
    slow = TickRateMeter(scenario(clock="lockstep"))
    run_at(slow, 0.1, 30.0)
    assert [slow.at(130.0 + seconds).ticks_per_s for seconds in (0.0, 5.0, 10.0)] == pytest.approx([0.1, 0.1, 0.1])


def test_an_agent_that_starts_anew_all_the_time_takes_one_row_and_no_round_of_it_is_forgotten() -> None:
    meter = TickRateMeter(scenario())
    for incarnation in range(1, 2001):
        meter.count(told("s1", incarnation, {"rounds": 1}))
        meter.count(told("s1", incarnation, {"rounds": 2, "late": 1}))
    meter.count(told("s2", 1, {"rounds": 5}))
    assert meter.rounds == 4005 and meter.whole().late == 2000
    assert max(len(held) for held in vars(meter).values() if isinstance(held, dict)) == 2


def test_rounds_are_counted_over_all_incarnations() -> None:
    pace = TickRateMeter(scenario())
    pace.count(told("s1", 1, {"rounds": 10, "skipped": 2, "late": 1}))
    pace.count(told("s1", 1, {"rounds": 20, "skipped": 4}))
    pace.count(told("s1", 2, {"rounds": 5, "late": 3}))
    pace.count(told("s2", 1, {"rounds": 7}))
    found = pace.at(100.0)
    assert (found.rounds, found.skipped, found.late) == (32, 4, 3)


def test_no_round_of_the_older_of_two_processes_of_a_name_counts_twice_when_it_is_heard_again() -> None:
    meter = TickRateMeter(scenario())
    for incarnation, rounds in ((1, 100), (2, 10), (1, 110)):
        meter.count(told("s1", incarnation, {"rounds": rounds}))
    assert meter.rounds == 120


def test_a_machine_that_keeps_up_gets_no_advice_and_one_that_does_not_gets_a_rate_that_fits() -> None:
    calm = TickRateMeter(scenario(clock="realtime", rate=2.0))
    run_at(calm, 8.0, 10.0, skipped=4)
    assert calm.at(110.0).advice == ""
    busy = TickRateMeter(scenario(clock="realtime", rate=2.0))
    run_at(busy, 8.0, 10.0, skipped=100)
    assert busy.at(110.0).advice == (
        "this machine is too small for 6 agents at rate 2 (50 % of the rounds are skipped): take --rate 1 or less, or --lockstep"
    )
    slow = TickRateMeter(scenario(clock="realtime", rate=2.0))
    run_at(slow, 4.0, 10.0)
    assert "(50 % of the ticks come): take --rate 1 or less" in slow.at(110.0).advice


def test_the_advice_names_a_class_of_the_users_own_which_may_be_what_is_slow() -> None:
    given = scenario(clock="realtime", rate=2.0)
    own = msgspec.structs.replace(given, control=msgspec.structs.replace(given.control, mode="laws:Slow"))
    busy = TickRateMeter(own)
    run_at(busy, 8.0, 10.0, skipped=100)
    assert (
        "laws:Slow takes too long, or this machine is too small for 6 agents at rate 2 (50 % of the rounds are skipped)"
        in busy.at(110.0).advice
    )


def test_the_rounds_that_a_paused_agent_skips_are_counted_and_give_no_advice() -> None:
    meter = TickRateMeter(scenario(clock="realtime", rate=2.0))
    run_at(meter, 8.0, 10.0, skipped=0)
    meter.excuse("s2")
    meter.count(told("s2", 1, {"rounds": 20, "skipped": 60}))
    assert (meter.at(110.0).skipped, meter.at(110.0).advice) == (60, "")
    meter.count(told("s3", 1, {"rounds": 20, "skipped": 60}))
    assert "are skipped): take --rate" in meter.at(110.0).advice


def test_there_is_no_advice_in_the_first_seconds_nor_in_lockstep() -> None:
    early = TickRateMeter(scenario(clock="realtime", rate=2.0))
    run_at(early, 8.0, 2.0, skipped=100)
    assert early.at(102.0).advice == ""
    patient = TickRateMeter(scenario(clock="lockstep", max_rate=2.5))
    run_at(patient, 1.0, 10.0, skipped=100)
    assert patient.at(110.0).advice == ""


@pytest.mark.parametrize("clock", ["realtime", "lockstep"])
def test_a_monitor_that_misses_messages_says_that_its_figures_are_too_bad(clock: str) -> None:
    meter = TickRateMeter(scenario(clock=clock))
    meter.unread = 7872
    run_at(meter, 8.0, 2.0)
    assert meter.at(110.0).advice == ""  # a machine that is too small is told first, and that needs some seconds
    run_at(meter, 8.0, 10.0)
    assert meter.at(110.0).advice == (
        "the monitor found no time for 7872 messages: holes and errors are overstated; the agents need a lower priority"
    )


def test_too_many_agents_for_the_cores_are_known_before_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3})
    wanted = {"team.composition": "48E", "run.dt": 0.25, "run.clock": "realtime"}
    assert too_small(resolve("quick", {**wanted, "run.rate": 0.5})) == ""
    text = too_small(resolve("quick", {**wanted, "run.rate": 1.0}))
    assert text == "48 agents at 4 ticks/s will be late on 1 core: take --rate 0.5 or less, fewer agents, or --lockstep"
    assert too_small(resolve("quick", {**wanted, "run.clock": "lockstep"})) == ""


def test_what_is_nothing_is_not_said() -> None:
    def words(**fields: Any) -> str:
        status = TickRate(**fields)
        return tick_rate_words({name: getattr(status, name) for name in status.__struct_fields__})

    assert words() == ""
    assert words(ticks_per_s=7.12) == "7.1 ticks/s"
    assert words(ticks_per_s=7.72, asked_per_s=8.0, skipped=3, late=1) == "7.7 of 8 ticks/s, 3 rounds skipped, 1 late"


def test_a_slow_world_says_its_factor_and_who_is_slow_or_stalled_is_named() -> None:
    meter = TickRateMeter(scenario(clock="lockstep", max_rate=2.5))
    run_at(meter, 4.0, 10.0)
    for name, stalled in (("s1", 0), ("s2", 900), ("s3", 0), ("s4", 0), ("s5", 0)):
        meter.count(told(name, 1, {"stalled_ms": stalled} if stalled else {}, pace=1 if name == "s2" else 4))
    found = meter.at(110.0)
    line = tick_rate_words({name: getattr(found, name) for name in found.__struct_fields__})
    assert line == "4.0 of 10 ticks/s, 0.40 x the speed asked for, pace 4: s1, s3, s4 and 1 more, stalled: s2"
