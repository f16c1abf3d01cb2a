"""Agents that die, stop, come back, or exist twice: who notices when, and what becomes of what they knew."""

import numpy as np
import pytest

from deploy.simulation import Simulation
from protocol.messages import Gossip
from protocol.node import Stop, received
from tests.swarm.scene import Watched, fault, ledger, tracking, watch

CLOCKS = pytest.mark.parametrize("clock", ["lockstep", "realtime"])
HOLE_AFTER = 0.02  # of the area, half a second after a death (the failure model)


def ledger_is_kept(seen: Watched, start: float, least: float = 0.99, most: float = 1.01) -> bool:
    """Whether the mass from the time `start` on is what it was."""
    masses = np.array(seen.masses[seen.at(start) :]) / seen.masses[0]
    print(f"mass {masses.min():.4f} to {masses.max():.4f}")
    return bool(masses.min() >= least and masses.max() <= most)


@CLOCKS
@pytest.mark.parametrize("who", ["s2", "30%", "50%"])
def test_after_deaths_the_rest_cover_the_arena_and_no_mass_is_lost(who: str, clock: str) -> None:
    seen = watch(ledger(fault(5.0, "kill", who)), clock=clock)
    assert max(seen.holes[seen.at(5.5) :]) <= HOLE_AFTER
    assert ledger_is_kept(seen, 5.5)
    assert len(seen.agents) == {"s2": 7, "30%": 6, "50%": 4}[who]


def test_of_a_hundred_targets_none_is_lost_either() -> None:
    seen = watch(ledger(fault(5.0, "kill", "50%"), side=100.0, run__seconds=10.0))
    assert seen.masses[0] == pytest.approx(100.0)
    assert ledger_is_kept(seen, 5.5, 0.9999, 1.0001)


def test_the_loss_of_the_token_closes_the_hole_in_the_next_tick() -> None:
    seen = watch(ledger(fault(5.0, "kill", "50%")))
    assert seen.holes[20] > 0.1 and max(seen.holes[21:]) == 0.0


def test_silence_alone_closes_it_after_four_rounds_and_not_before() -> None:
    seen = watch(ledger(fault(5.0, "kill", "50%", silent=True)))
    assert min(seen.holes[20:24]) > 0.1 and max(seen.holes[25:]) == 0.0
    assert ledger_is_kept(seen, 6.5)


def test_losses_in_bursts_keep_nobody_alive_who_has_died_in_silence() -> None:
    """Claims state how old their generators are, so that the dead are given up after four rounds everywhere."""
    counted: set[int] = set()

    def look(tick: int, simulation: Simulation) -> None:
        living = simulation.agents.keys()
        counted.update(tick for agent in simulation.agents.values() if agent.outcome.belief.generator_names - living)

    faults = fault(0.0, "drop", "100%", 0.3, burst=4.0), fault(5.0, "kill", "50%", silent=True)
    watch(ledger(*faults, run__seconds=10.0), clock="realtime", at_tick=look)
    assert counted and max(counted) <= 25


@CLOCKS
def test_one_that_comes_back_finds_its_body_where_it_stood_and_nothing_is_lost(clock: str) -> None:
    poses = {}

    def look(tick: int, simulation: Simulation) -> None:
        truth = simulation.scorer.truth
        poses[tick] = dict(zip(truth.bodies, truth.poses.tolist()))

    seen = watch(ledger(fault(5.0, "kill", "s2,s5", seconds=4.0)), clock=clock, at_tick=look)
    assert seen.agents["s2"].incarnation == 2
    assert poses[21]["s2"] == poses[36]["s2"] != poses[79]["s2"] and poses[21]["s5"] == poses[36]["s5"]
    assert poses[21]["s1"] != poses[36]["s1"]
    assert ledger_is_kept(seen, 5.5)
    assert set(seen.views[seen.at(10.0) :]) == {1}


@CLOCKS
@pytest.mark.parametrize("seconds", [1.0, 5.0])
def test_a_stopped_agent_wakes_up_and_changes_nothing_with_its_stale_claim(seconds: float, clock: str) -> None:
    seen = watch(ledger(fault(5.0, "pause", "s2,s6", seconds=seconds)), clock=clock)
    assert ledger_is_kept(seen, 5.0 + seconds + 1.0)
    assert set(seen.views[seen.at(5.0 + seconds + 1.0) :]) == {1}
    assert sorted(seen.agents) == [f"s{number}" for number in range(1, 9)]


def test_while_it_is_stopped_its_cell_is_adopted_by_the_others() -> None:
    seen = watch(ledger(fault(5.0, "pause", "s2,s6", seconds=10.0)), clock="realtime")
    assert max(seen.holes[seen.at(6.5) : seen.at(14.5)]) == 0.0
    assert ledger_is_kept(seen, 6.5)


@pytest.mark.slow
def test_a_slow_agent_is_waited_for_and_not_declared_dead() -> None:
    slow = watch(tracking(fault(5.0, "slow", "s2", 0.1)), clock="realtime")
    assert set(slow.views) == {1}
    very_slow = watch(ledger(fault(5.0, "slow", "s2", 0.6, seconds=10.0)), clock="realtime")
    agent = very_slow.agents["s2"]
    left_out = agent.counters["skipped"] + agent.counters["spared"]
    assert left_out > 10 and agent.tick == 79
    print(f"{left_out} ticks left out, {agent.counters['spared']} of them in step")
    assert ledger_is_kept(very_slow, 16.0)
    for name, other in very_slow.agents.items():
        assert name == "s2" or other.peer_table.peers["s2"].silent_rounds < 4


def test_of_two_processes_with_one_name_the_older_stops_itself_with_code_3() -> None:
    seen = watch(ledger(fault(5.0, "twin", "s3")), clock="realtime")
    stop = seen.simulation.bus.stopped["s3"]
    assert stop.code == 3 and "younger" in stop.reason
    assert sorted(seen.agents) == ["s1", "s2", "s3#2", "s4", "s5", "s6", "s7", "s8"]
    assert ledger_is_kept(seen, 6.5) and set(seen.views[seen.at(6.5) :]) == {1}


@pytest.mark.parametrize("back", [False, True])
def test_clocks_that_are_wrong_from_the_start_change_nothing(back: bool) -> None:
    wrong = (fault(0.0, "jump", "3", 288.0, back=back), fault(0.0, "jump", "s7", 1e6))
    right, skewed = (watch(tracking(*faults, run__seconds=10.0)).result for faults in ((), wrong))
    assert right.transcript == skewed.transcript


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_clocks_that_jump_at_half_time_change_nothing(clock: str) -> None:
    jumps = (fault(5.0, "jump", "s1,s2", 288.0), fault(5.0, "jump", "s3", 288.0, back=True))
    right, jumpy = (watch(tracking(*faults, run__seconds=10.0), clock=clock).result for faults in ((), jumps))
    assert right.transcript == jumpy.transcript


@pytest.mark.parametrize("restart", [False, True], ids=["same incarnation", "old incarnation"])
def test_a_replayed_message_changes_nothing(restart: bool) -> None:
    scenario = tracking(*((fault(4.0, "kill", "s2", seconds=1.0),) if restart else ()), run__seconds=12.0)
    kept: list[Gossip] = []

    def replay(tick: int, simulation: Simulation) -> None:
        said = simulation.agents["s2"]._gossip if "s2" in simulation.agents else None
        if said is not None and tick < 15:
            kept.append(said)
        for endpoint in simulation.bus._endpoints.values() if tick > 30 else ():
            if endpoint.node.role == "agent" and endpoint.node.name != "s2":
                simulation.bus._schedule(endpoint, received(kept[tick % len(kept)]), 0.0)

    left_alone, replayed = watch(scenario), watch(scenario, at_tick=replay)
    assert len(kept) > 10 and replayed.result.transcript == left_alone.result.transcript
    reason = "rejected.incarnation" if restart else "rejected.closed"
    assert all(agent.counters[reason] >= 17 for name, agent in replayed.agents.items() if name != "s2")


def test_the_last_agent_alive_owns_everything() -> None:
    seen = watch(ledger(fault(5.0, "kill", "s1,s2,s3,s4,s5,s6,s7")))
    assert seen.holes[-1] == 0.0 and ledger_is_kept(seen, 5.5)


def test_a_new_incarnation_listens_for_one_round_and_its_stop_is_no_fault_of_others() -> None:
    listened: list[tuple[int, bool]] = []

    def look(tick: int, simulation: Simulation) -> None:
        agent = simulation.agents.get("s2")
        if agent is not None and agent.incarnation == 2 and agent.tick >= 0:
            listened.append((agent.tick, bool(agent.outcome.belief.mine.claim.names)))

    seen = watch(ledger(fault(5.0, "kill", "s2", seconds=2.0)), at_tick=look)
    first = listened[0][0]
    with_cell = [tick for tick, has_cell in listened if has_cell]
    assert first + 1 <= with_cell[0] <= first + 3
    assert not any(isinstance(stop, Stop) and stop.code == 3 for stop in seen.simulation.bus.stopped.values())


@CLOCKS
def test_when_all_die_and_come_back_at_once_they_start_again_from_the_prior(clock: str) -> None:
    seen = watch(ledger(fault(5.0, "kill", "100%", seconds=2.0)), clock=clock)
    assert ledger_is_kept(seen, 9.0) and seen.holes[-1] == 0.0
