"""Who hears its neighbours only learns from their claims that somebody stands near whom it does not hear, and asks for a new session."""

from typing import Literal

import numpy as np
import pytest

from agents.membership.half_open_link import HalfOpenLinkDetector, WorldLinkDetector
from deploy.simulation import Simulation
from protocol.fields import pack
from protocol.messages import Gossip
from protocol.observer_messages import Truth
from protocol.session_watchdog import FIRST_REST, PATIENCE
from tests.swarm.scene import ledger

LEASE = 5.0  # s


def claim(sender: str, tick: int, **places: tuple[float, float]) -> Gossip:
    """A gossip that claims a cell bounded by the generators at these places."""
    pairs = {sender: (10.0, 10.0), **places}
    generators = np.array([(x, y, 2.0) for x, y in pairs.values()])
    words = {"pose": (10.0, 10.0, 0.0), "cod": (10.0, 10.0), "power_radius": 2.0, "unused": 20.0}
    return Gossip(sender=sender, incarnation=1, tick=tick, **words, claim_names=tuple(pairs), claim_bytes=pack(generators, "<f8"))


def alarms(
    hearsay: HalfOpenLinkDetector, seconds: float, known: tuple[str, ...] = ("s2",), named: tuple[float, float] = (20.0, 10.0)
) -> list[float]:
    """When it says that s3 should be heard, whom s2 names in every round of 0.5 s; what lies east of x = 50 is not overlooked."""
    found = []
    for tick in range(int(2.0 * seconds)):
        now = 0.5 * tick
        if hearsay.find_unheard([claim("s2", tick, s1=(0.0, 0.0), s3=named)], known, lambda place: place[0] < 50.0, tick, now):
            found.append(now)
    return found


def test_somebody_near_who_is_named_all_the_time_and_never_heard_is_an_alarm_and_later_ones_are_rare() -> None:
    times = alarms(HalfOpenLinkDetector("s1", 16, LEASE), 100.0)
    assert times[0] == 8.0 and times[1] == 8.0 + FIRST_REST and times[2] == times[1] + 2.0 * FIRST_REST


def test_whom_i_know_and_who_stands_where_i_do_not_listen_are_none() -> None:
    assert (
        alarms(HalfOpenLinkDetector("s1", 16, LEASE), 60.0, known=("s2", "s3"))
        == alarms(HalfOpenLinkDetector("s1", 16, LEASE), 60.0, named=(60.0, 10.0))
        == []
    )


def test_where_ticks_fly_it_takes_its_seconds() -> None:
    hearsay = HalfOpenLinkDetector("s1", 16, LEASE)
    words = [(tick, 0.01 * tick) for tick in range(1000)]
    found = [
        now for tick, now in words if hearsay.find_unheard([claim("s2", tick, s3=(20.0, 10.0))], ("s2",), lambda place: True, tick, now)
    ]
    assert found == [pytest.approx(PATIENCE)]


class Split:
    """Links of which one is dead in both directions (`protocol.virtual.Link`)."""

    def __init__(self) -> None:
        self.pair: set[str] = set()

    def carry(self, sender: str, receiver: str, key: str, payload: bytes, now: float) -> list[tuple[float, bytes]]:
        return [] if {sender, receiver} == self.pair else [(0.0, payload)]


@pytest.mark.slow
@pytest.mark.parametrize("clock", ["lockstep", pytest.param("realtime", marks=pytest.mark.nightly)])
def test_when_two_of_sixteen_do_not_hear_each_other_both_ask_for_a_new_session_and_nobody_else_does(
    clock: Literal["lockstep", "realtime"],
) -> None:
    split = Split()
    scenario = ledger(agents=16, side=80.0, run__seconds=24.0, timing__interest="neighbours")
    simulation = Simulation(scenario, link=split, clock=clock)

    def cut(truth: Truth) -> None:
        if truth.tick == 20:
            one = simulation.agents["s1"]
            split.pair = {"s1", one.outcome.belief.mine.claim.names[1]}  # whose cell is beside its own

    simulation.on_truth = cut
    simulation.run()
    reopened = {name: agent.counters["reopened"] for name, agent in simulation.agents.items()}
    assert {name for name, count in reopened.items() if count} == split.pair


@pytest.mark.parametrize("clock", [pytest.param("lockstep", marks=pytest.mark.slow), "realtime"])
def test_who_is_cut_off_from_the_world_alone_asks_for_a_new_session_and_nobody_else_does(clock: Literal["lockstep", "realtime"]) -> None:
    split = Split()
    simulation = Simulation(ledger(agents=9, side=60.0, run__seconds=24.0, timing__interest="neighbours"), link=split, clock=clock)

    def cut(truth: Truth) -> None:
        if truth.tick == 20:
            split.pair = {"s1", "world"}

    simulation.on_truth = cut
    simulation.run()
    reopened = {name: agent.counters["reopened"] for name, agent in simulation.agents.items() if agent.counters["reopened"]}
    assert reopened == {"s1": 1} if clock == "realtime" else reopened.keys() == {"s1"}  # in lockstep the world waits, and minutes pass
    assert simulation.agents["s1"].tick < 25


def test_who_is_left_behind_says_so_after_its_seconds_and_then_rarely() -> None:
    behind = WorldLinkDetector(LEASE)
    times = [0.5 * step for step in range(200) if behind.should_reopen(7, 0.5 * step)]
    assert times[0] == PATIENCE and times[1] == PATIENCE + FIRST_REST and times[2] == times[1] + 2.0 * FIRST_REST


def test_where_links_may_be_silent_for_long_both_detectors_wait_as_long() -> None:
    assert alarms(HalfOpenLinkDetector("s1", 16, 30.0), 100.0)[0] == 30.0
    behind = WorldLinkDetector(30.0)
    assert next(0.5 * step for step in range(200) if behind.should_reopen(7, 0.5 * step)) == 30.0


def test_who_follows_at_a_distance_is_not_left_behind() -> None:
    behind = WorldLinkDetector(LEASE)
    assert not any(behind.should_reopen(step // 4, 0.5 * step) for step in range(400))
    assert not any(behind.should_reopen(9, 1000.0 - 0.5 * step) for step in range(400))  # a clock that runs back
