"""The figures of a result, by hand: one target in a 10 x 10 m arena of two agents, ten ticks, of which the last five are steady."""

import tracemalloc

import msgspec
import numpy as np
import pytest

from deploy.scenario import Scenario, resolve
from deploy.scoring.scorer import Scorer
from deploy.scoring.tracks import TrackLog
from deploy.simulation import Simulation
from protocol.gaussian_components import COMPONENT
from protocol.messages import Gossip
from protocol.node import Alive, Gone, received
from protocol.observer_messages import Estimate, Truth
from tests.deploy.test_monitor_node import EMPTY, LEFT, RIGHT, TARGET, WHOLE, estimate, longer, scenario, started, truth

__all__ = ["scenario"]  # the fixture
EARLY, LATE = np.add(TARGET, [3.0, 4.0]), np.add(TARGET, [0.0, 1.0])  # 5 m and 1 m away from the target
TWO = np.vstack([LATE, np.add(TARGET, [0.0, 7.0])])  # a false one beside


def played(scenario: Scenario) -> Scorer:
    scenario = msgspec.structs.replace(scenario, study=msgspec.structs.replace(scenario.study, steady_share=0.5))
    scorer = started(scenario)
    for tick in range(10):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("a", tick, LEFT, EARLY if tick < 5 else TWO, mass=0.5 if tick < 5 else 2.5), float(tick))
        scorer.handle(estimate("b", tick, {3: EMPTY, 4: WHOLE}.get(tick, RIGHT), mass=0.0), float(tick))
    return scorer


def test_means_are_over_the_whole_run_or_over_its_steady_part(scenario: Scenario) -> None:
    """OSPA is 5 m, then (1 + 10) / 2; GOSPA is 5 m, then 1 + 10 / 2."""
    result = played(scenario).result(1.0)
    assert (result.mean_ospa, result.steady_ospa, result.final_ospa) == pytest.approx((5.25, 5.5, 5.5))
    assert (result.mean_gospa, result.steady_gospa, result.final_gospa) == pytest.approx((5.5, 6.0, 6.0))


def test_the_cardinality_error_is_that_of_the_mass(scenario: Scenario) -> None:
    result = played(scenario).result(1.0)
    assert result.cardinality_error == pytest.approx(1.5)  # 2.5 expected for one target; two were reported


def test_the_largest_hole_and_overlap_of_the_run_count(scenario: Scenario) -> None:
    result = played(scenario).result(1.0)
    assert (result.hole_area, result.overlap_area) == pytest.approx((0.5, 0.5))


def test_the_mass_that_is_reported_is_that_of_the_particles_that_are_said(scenario: Scenario) -> None:
    scorer = started(scenario)
    scorer.handle(truth(0), 0.0)
    scorer.handle(estimate("a", 0, WHOLE, mass=0.5), 0.0)
    states, ids = np.zeros((4, 4), "<f4").tobytes(), np.arange(4, dtype="<u8").tobytes()
    pose, claim = (1.0, 1.0, 0.0), np.array([[1.0, 1.0, 0.0]]).tobytes()
    common = {"sender": "a", "incarnation": 1, "pose": pose, "cod": pose[:2], "power_radius": 0.0, "unused": 0.0}
    gossip = Gossip(**common, tick=1, claim_tick=0, claim_names=("a",), claim_bytes=claim, weight=0.2, states_bytes=states, ids_bytes=ids)
    scorer.handle(received(gossip), 0.5)
    assert scorer.result(1.0).mass_residual == pytest.approx(abs(0.5 - 4 * 0.2))


@pytest.mark.parametrize(("pace", "residual"), [(1, 0.25), (2, 0.0)])
def test_gaussians_are_mass_too_and_an_estimate_of_a_slower_pace_is_not_compared(scenario: Scenario, pace: int, residual: float) -> None:
    """1.75 expected, and a mixture of two Gaussians of 0.75; at a slower pace the estimate is made before the scans of the peers come."""
    scorer = started(scenario)
    [said] = estimate("a", 0, WHOLE, mass=1.75).batch.messages
    assert isinstance(said, Estimate)
    scorer.handle(received(msgspec.structs.replace(said, pace=pace)), 0.0)
    mixture = np.zeros(2, COMPONENT)
    mixture["weight"] = 0.75
    pose, claim = (1.0, 1.0, 0.0), np.array([[1.0, 1.0, 0.0]]).tobytes()
    common = {"sender": "a", "incarnation": 1, "pose": pose, "cod": pose[:2], "power_radius": 0.0, "unused": 0.0}
    gossip = Gossip(**common, tick=1, claim_tick=0, claim_names=("a",), claim_bytes=claim, components_bytes=mixture.tobytes())
    scorer.handle(received(gossip), 0.5)
    assert scorer.result(1.0).mass_residual == residual


def test_who_has_been_silent_for_longer_than_it_stays_a_generator_is_not_scored(scenario: Scenario) -> None:
    """Four rounds; the world is far ahead of its word, and a tick is scored without it."""
    scorer = started(longer(scenario))
    for tick in range(40):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("a", tick, LEFT, TARGET), float(tick))
        if tick == 0:
            scorer.handle(estimate("b", tick, RIGHT, LATE), 0.0)
    estimated = [score.estimated for score in scorer.scores]
    assert estimated[:8] == [2] * 5 + [1] * 3


def test_the_targets_of_an_old_estimate_have_moved_on_by_their_velocity(scenario: Scenario) -> None:
    """Its agent says nothing after tick 0; in the ticks since, the estimate comes closer to the target by 1 m in each."""
    scorer = started(longer(scenario))
    speed = 1.0 / scenario.run.dt
    for tick in range(40):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("a", tick, LEFT), float(tick))
        if tick == 0:
            scorer.handle(estimate("b", tick, RIGHT, np.add(TARGET, [0.0, 4.0]), velocity=(0.0, -speed)), 0.0)
    assert [score.ospa for score in scorer.scores[:5]] == pytest.approx([4.0, 3.0, 2.0, 1.0, 0.0], abs=1e-6)


def test_between_rare_estimates_the_last_ones_count() -> None:
    simulation = Simulation(resolve("quick", {"run.seconds": 10.0, "timing.estimate_every": 10}))
    simulation.run()
    scores = simulation.scorer.scores
    assert len(scores) == 40 and max(score.hole for score in scores) < 1e-6
    assert all(len({score.estimated for score in scores[start : start + 10]}) == 1 for start in range(0, 40, 10))


def test_tracks_are_compared_over_ten_seconds_however_rare_estimates_are() -> None:
    windows = [TrackLog(resolve("quick", {"timing.estimate_every": every}))._window for every in (1, 4)]
    assert windows == [40, 40]


def test_a_tick_is_scored_with_the_estimates_of_that_tick_though_later_ones_are_there(scenario: Scenario) -> None:
    """The slower agent answers tick 0 after the faster one has answered tick 1."""
    scorer = started(scenario)
    scorer.handle(truth(0), 0.0)
    scorer.handle(estimate("a", 0, LEFT, EARLY), 0.0)
    scorer.handle(truth(1), 1.0)
    scorer.handle(estimate("a", 1, LEFT, LATE), 1.0)
    for tick in (0, 1):
        scorer.handle(estimate("b", tick, RIGHT), 1.0)
    assert [score.ospa for score in scorer.scores] == pytest.approx([5.0, 1.0])


def test_a_tick_that_an_agent_left_out_is_scored_with_its_estimate_before_and_not_with_a_later_one(scenario: Scenario) -> None:
    scorer = started(scenario)
    for tick in range(3):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("b", tick, RIGHT), float(tick))
        if tick != 1:
            scorer.handle(estimate("a", tick, LEFT, LATE if tick else EARLY), float(tick))
    scorer.finish(3.0)
    assert [score.ospa for score in scorer.scores] == pytest.approx([5.0, 5.0, 1.0])


def test_an_estimate_that_comes_after_its_tick_was_scored_counts_for_the_next(scenario: Scenario) -> None:
    scorer = started(longer(scenario))
    for tick in range(26):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("b", tick, RIGHT), float(tick))
        if tick == 23:
            scorer.handle(estimate("a", 0, LEFT, LATE), float(tick))
    assert [score.estimated for score in scorer.scores] == [0, 0, 1, 1]


def test_what_a_dead_process_said_does_not_count_for_its_successor(scenario: Scenario) -> None:
    scorer = started(scenario)
    for tick in range(3):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("b", tick, RIGHT), float(tick))
        if tick == 0:
            scorer.handle(estimate("a", tick, LEFT, LATE), float(tick))
            scorer.handle(Gone("agent", "a", 1), 0.5)
            scorer.handle(Alive("agent", "a", 2), 0.6)
    scorer.finish(3.0)
    assert [score.estimated for score in scorer.scores] == [1, 0, 0]
    assert scorer.scores[-1].hole == pytest.approx(0.5)


@pytest.mark.parametrize(("clock", "scored"), [("lockstep", [0, 0, 1, 5]), ("realtime", [0, 1, 3, 6])])
def test_a_guest_that_states_no_estimates_holds_up_no_scores(clock: str, scored: list[int], scenario: Scenario) -> None:
    """In lockstep it is waited for until the world has been ahead for 2 s; a member for 20 ticks as well."""
    run = msgspec.structs.replace(scenario.run, clock=clock, seconds=40.0)
    scorer = started(msgspec.structs.replace(scenario, run=run))
    scorer.handle(Alive("agent", "x", 1), 0.0)
    found = []
    for tick, now in ((0, 0.0), (1, 1.0), (2, 2.0), (3, 3.0), (4, 4.0), (5, 5.0), (6, 7.0)):
        scorer.handle(truth(tick, ("a", "b", "x")), now)
        for name, cell in (("a", LEFT), ("b", RIGHT)):
            scorer.handle(estimate(name, tick, cell, TARGET), now)
        found.append(len(scorer.scores))
    assert [found[place] for place in (0, 1, 3, 6)] == scored
    assert all(score.hole == 0.0 for score in scorer.scores)


def seen(log: TrackLog, tick: int, targets: int, estimates: int) -> tuple[np.ndarray, np.ndarray]:
    """Show a log a tick of so many targets and estimates; their places (T, 2) and (M, 2), m."""
    places, found = np.random.default_rng(tick).random((2, targets + estimates, 2))
    places, found = places[:targets], found[:estimates]
    ids, labels = np.arange(targets, dtype="<u8"), np.arange(1, estimates + 1, dtype="<u8")
    labels[1:2] = 0
    truth = Truth(sender="world", incarnation=1, tick=tick, time=0.25 * tick, ids_bytes=ids.tobytes(), targets_bytes=places.tobytes())
    [said] = estimate("s1", tick, EMPTY, found).batch.messages
    assert isinstance(said, Estimate)
    said = msgspec.structs.replace(said, labels_bytes=labels.tobytes())
    log.see(truth, [said], said.targets)
    return places, found


def test_tracks_come_back_tick_by_tick_as_they_were_seen() -> None:
    log, sizes = TrackLog(resolve("quick")), [(3, 2), (0, 0), (0, 1), (2, 0), (1, 4)]
    kept = [seen(log, tick, *size) for tick, size in enumerate(sizes)]
    assert [(len(tick.ids), len(tick.labels)) for tick in log.ticks] == sizes
    for tick, labelled, (places, found) in zip(log.ticks, log.labelled, kept, strict=True):
        assert (tick.targets == places).all() and (tick.estimates == found).all()
        assert tick.ids.tolist() == list(range(len(places))) and labelled.tolist() == [number != 1 for number in range(len(found))]
        assert tick.labels[labelled].tolist() == [number + 1 for number in range(len(found)) if number != 1]


def test_a_tick_of_ten_targets_takes_the_memory_of_its_numbers() -> None:
    """10 x (8 + 16) bytes of targets, 10 x (8 + 16 + 1) of estimates and two sizes are 506 bytes. A run may have a million ticks."""
    log = TrackLog(resolve("quick"))
    seen(log, 0, 10, 10)
    tracemalloc.start()
    try:
        for tick in range(1, 2001):
            seen(log, tick, 10, 10)
        assert tracemalloc.get_traced_memory()[0] < 2000 * 700
    finally:
        tracemalloc.stop()
