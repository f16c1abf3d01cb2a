"""A swarm whose messages come late: its cells tile the arena, it is still one filter, and it is on time again when they are."""

import statistics
from dataclasses import dataclass, field

import msgspec
import numpy as np
import pytest

from agents.agent import Agent
from agents.backend import PLAIN
from agents.config import ExtractionSettings
from agents.coverage.control import ControlInput, ControlLaw, Situation
from agents.gossip.table import announced_sensor, gossip_table
from agents.gossip_history import GossipHistory
from agents.round import context_of
from agents.tracking.belief import owned_by_sender
from agents.tracking.births import background_births
from agents.tracking.claims import NO_CLAIM
from agents.tracking.extraction import estimate_targets
from agents.tracking.gaussian_reduction import estimate_and_label
from agents.tracking.gaussians import Mixture
from agents.tracking.particles import NO_PARTICLES, Particles, canonical, join, select
from agents.tracking.phd import predict
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput, belief_without_claim
from deploy.scenario import Scenario, agent_config, resolve
from deploy.simulation import Simulation, compiled
from deploy.verify.central_filter import _widely, drawn, particle_difference
from protocol.compact_particles import quantised
from protocol.keys import order
from protocol.messages import Gossip
from protocol.settings import sensor_of
from tests.swarm.scene import Watched, fault, tracking, watch

START, DT = 4.0, 0.5


def lags(simulation: Simulation) -> set[int]:
    return {agent._rounds.lag.current for agent in simulation.agents.values()}


@pytest.mark.parametrize(
    ("delay", "interest"), [(0.5, "all"), *(pytest.param(*each, marks=pytest.mark.slow) for each in [(0.5, "neighbours"), (1.0, "all")])]
)
def test_from_the_tick_on_in_which_messages_become_late_no_place_is_left_out_or_claimed_twice(delay: float, interest: str) -> None:
    """A gossip may be missing in the tick in which an agent begins to hear a peer: it was sent before that."""
    settings = {"run__dt": DT, "run__seconds": 12.0, "timing__look_ahead": 2.5, "timing__interest": interest}
    missing = []
    for seed in (1, 2, 3):
        seen = watch(tracking(fault(START, "delay", "100%", delay), run__seed=seed, **settings), clock="realtime")
        since = seen.at(START)
        assert max(seen.holes[since:]) < 1e-9 and max(seen.overlaps[since:]) < 1e-9
        assert lags(seen.simulation) == {round(delay / DT)}
        missing.append(sum(agent.counters["missing"] for agent in seen.agents.values()))
    print("missing:", missing)
    assert statistics.median(missing) <= 1


def test_when_the_messages_of_some_agents_are_late_all_agents_wait_for_them() -> None:
    """Too few are late to hold a round, so only the lag that all keep lets their scans and generators be in it."""
    scenario = tracking(fault(START, "delay", "50%", 0.5), run__dt=DT, run__seconds=12.0, timing__look_ahead=2.5)
    missing: list[int] = []

    def look(tick: int, simulation: Simulation) -> None:
        missing.append(sum(agent.counters["missing"] for agent in simulation.agents.values()))

    seen = watch(scenario, clock="realtime", at_tick=look)
    agreed = seen.at(START + 2.0)  # the lag is measured, said and kept by then
    assert lags(seen.simulation) == {1}
    assert missing[agreed] == missing[-1] and max(seen.holes[agreed:]) < 1e-9 and max(seen.overlaps[agreed:]) < 1e-9


def test_the_lag_goes_with_the_delay_and_leaves_no_hole() -> None:
    scenario = tracking(fault(START, "delay", "100%", 0.7, seconds=4.0), run__dt=DT, run__seconds=14.0, timing__look_ahead=2.5)
    seen = watch(scenario, clock="realtime")
    assert max(seen.holes) < 1e-9 and lags(seen.simulation) == {0}
    assert all(agent.outcome.belief.tick == agent.tick for agent in seen.agents.values())


def test_without_the_setting_nothing_is_played_late() -> None:
    scenario = tracking(fault(START, "delay", "100%", 0.5), run__dt=DT, run__seconds=10.0, timing__look_ahead=0.0)
    seen = watch(scenario, clock="realtime")
    assert lags(seen.simulation) == {0} and max(seen.holes) > 0.0


def replayed(scenario: Scenario, owned: Particles, ticks: list[dict[str, Gossip]], claims: dict[str, Gossip]) -> Particles:
    """One filter over the arena some ticks later; new particles are drawn in the claims of the last tick alone."""
    config, backend = agent_config(scenario), compiled()
    for gossips in ticks:
        said = [gossips[name] for name in sorted(gossips, key=order)]
        step = Step(config, said[0].tick)
        born = background_births(step)
        sensors = [
            announced_sensor(gossip.sender, sensor_of(config, scenario.members[gossip.sender]), config.detection.clutter) for gossip in said
        ]
        everywhere = RegionInput("", 0, sensors[0].sensor, (0.0, 0.0, 0.0), _widely(config.arena), NO_CLAIM)
        predicted = predict(canonical(owned), step)
        updated = backend.update_regions(gossip_table(said, sensors, config), owned, born, [everywhere], step)[0].updated
        owned = select(updated, config.arena.holds(*updated.states[:, :2].T))  # a tick ends with what is in the arena
    return drawn(owned, predicted, {name: owned_by_sender(gossip).claim for name, gossip in claims.items()}, step)


def told(gossips: dict[str, Gossip]) -> Particles:
    return canonical(join([owned_by_sender(gossip).targets for gossip in gossips.values()]))


@pytest.mark.parametrize(("lag", "speed", "side"), [(1, 2.0, 40.0), (2, 2.0, 40.0), (4, 8.0, 60.0)])
def test_the_swarm_is_one_filter_that_draws_its_particles_once_in_so_many_ticks(lag: int, speed: float, side: float) -> None:
    """`speed`: of particles, m/s. Fast ones come from beyond the halo of a cell within the ticks that are replayed."""
    gossips: dict[int, dict[str, Gossip]] = {}
    late = fault(START, "delay", "100%", lag * DT)
    scenario = tracking(late, side=side, run__dt=DT, run__seconds=14.0, timing__look_ahead=2.5, filter__speed=speed)

    def look(tick: int, simulation: Simulation) -> None:
        for agent in simulation.agents.values():
            assert isinstance(agent, Agent)
            for said_at, heard in agent._rounds.recent._said.items():
                own = heard.get(agent.name)
                if own is not None:
                    gossips.setdefault(said_at, {})[agent.name] = own[0]

    watch(scenario, clock="realtime", at_tick=look)
    tick = 22  # of the claims; all say so, lag ticks later than usual
    first, last = gossips[tick], gossips[tick + 1 + lag]
    assert {gossip.claim_tick for gossip in last.values()} == {tick} and {gossip.behind for gossip in last.values()} == {lag}
    assert {gossip.claim_tick for gossip in first.values()} == {tick - lag - 1}
    scans = [gossips[stamp] for stamp in range(tick - lag, tick + 1)]
    central = replayed(scenario, told(first), scans, last)
    apart = particle_difference(told(last), central)
    assert apart.exact, apart
    assert len(np.unique(central.ids)) > 100


def test_an_owner_keeps_the_particles_that_it_states_in_few_bytes() -> None:
    seen = watch(tracking(run__dt=DT, run__seconds=6.0, filter__compact=True), clock="realtime")
    for agent in seen.agents.values():
        mine = agent.outcome.belief.mine.targets
        states, ids = quantised(mine.states, seen.simulation.scenario.filter.speed, agent.name, agent.outcome.belief.tick)
        assert np.array_equal(states, mine.states) and np.array_equal(ids, mine.ids)
    assert sum(len(agent.outcome.belief.mine.targets.ids) for agent in seen.agents.values()) > 100


def test_made_up_ticks_of_one_peer_push_out_no_gossip_of_the_own_agent_or_of_several() -> None:
    context = context_of(agent_config(resolve("efficacy", {"run.dt": DT})), "s1", "A", PLAIN)
    history, sensor = GossipHistory(context, 4), context.announced

    def said(name: str, tick: int) -> Gossip:
        return Gossip(sender=name, incarnation=1, tick=tick, pose=(1.0, 1.0, 0.0), cod=(1.0, 1.0), power_radius=0.0, unused=0.0)

    history.put(said("s1", 7), sensor)
    for name in ("s3", "s2"):
        history.put(said(name, 8), sensor)
    assert history.table(said("s1", 8)).names == ("s1", "s2", "s3")
    for tick in range(1000, 1200):
        history.put(said("s4", tick), sensor)
    assert history.table(said("s1", 7)).names == ("s1",) and history.own_gossip(7, said("s1", 9)).tick == 7
    assert history.own_gossip(7, said("s1", 9)).scanned and history.has_later("s3", 7) and len(history._said) <= history._most_ticks


def test_a_replay_begins_with_the_belief_of_the_tick_or_with_the_oldest() -> None:
    context = context_of(agent_config(resolve("efficacy", {"run.dt": DT})), "s1", "A", PLAIN)
    history, beliefs = GossipHistory(context, 2), [belief_without_claim("s1", tick, NO_PARTICLES, ()) for tick in range(8)]
    for belief in beliefs[:7]:
        history.keep(belief)
    assert [history.at_or_before(tick, beliefs[7]).tick for tick in (9, 7, 6, 4, 0)] == [7, 7, 6, 4, 3]


def test_a_density_that_was_moved_on_shows_weak_targets_and_none_twice() -> None:
    """After 2 s: a quarter of a target is left at its peak, or 1.3 expected targets."""
    scenario = resolve("efficacy", {"run.dt": DT})
    now = scenario.extraction
    later = GossipHistory(context_of(agent_config(scenario), "s1", "A", PLAIN), 4).blurred_config(4).extraction

    def found(mass: float, settings: ExtractionSettings) -> int:
        places = np.tile([10.5, 10.5, 0.0, 0.0], (10, 1))
        particles = Particles(places, np.full(10, mass / 10.0), np.arange(10, dtype=np.uint64), np.zeros(10, np.uint64))
        return len(estimate_targets(particles, settings).positions)

    assert [found(0.25, now), found(0.25, later)] == [0, 1]
    assert [found(1.3, msgspec.structs.replace(now, threshold=later.threshold)), found(1.3, later)] == [2, 1]
    assert found(1.7, later) == 2


def test_a_mixture_that_was_moved_on_shows_weak_targets_and_none_twice() -> None:
    """The same of one component; and what has another label within a peak is a target of its own only if it holds as much."""
    scenario = resolve("efficacy", {"run.dt": DT})
    now = scenario.extraction
    later = GossipHistory(context_of(agent_config(scenario), "s1", "A", PLAIN), 4).blurred_config(4).extraction

    def found(settings: ExtractionSettings, *masses: float) -> int:
        numbers = np.arange(1, 1 + len(masses), dtype=np.uint64)
        mixture = Mixture(np.array(masses), np.full((len(masses), 4), 10.0), np.tile(np.eye(4), (len(masses), 1, 1)), numbers, numbers)
        return len(estimate_and_label(mixture, settings.threshold, settings.beside, 2.0)[0].positions)

    lower = msgspec.structs.replace(now, threshold=later.threshold)
    assert [found(now, 0.25), found(later, 0.25)] == [0, 1]
    assert [found(lower, 1.3), found(later, 1.3)] == [2, 1]
    assert [found(lower, 0.8, 0.3), found(later, 0.8, 0.3)] == [2, 1]
    assert [found(later, 1.7), found(later, 0.8, 0.7)] == [2, 2]


@dataclass
class Noted(ControlLaw):
    """A control law, and of its commands the ticks, and for how many ticks each was to last."""

    law: ControlLaw
    asked: list[tuple[int, int]] = field(default_factory=list)

    def command(self, situation: Situation) -> ControlInput:
        self.asked.append((situation.tick, situation.ticks))
        return self.law.command(situation)


def asked(scenario: Scenario) -> tuple[Watched, list[np.ndarray]]:
    """The run of a scenario in real time, and for each agent when its law was asked and for how many ticks: (N, 2)."""
    laws: dict[str, Noted] = {}

    def look(tick: int, simulation: Simulation) -> None:
        for agent in simulation.agents.values():
            if agent.name not in laws:
                laws[agent.name] = Noted(agent.context.law)
                agent.context = agent.context._replace(law=laws[agent.name])

    seen = watch(scenario, clock="realtime", at_tick=look)
    return seen, [np.array(noted.asked) for noted in laws.values()]


def test_a_law_is_asked_for_one_command_in_a_tick_also_where_rounds_are_played_late() -> None:
    """A law with a memory would else see a tick again that it has left."""
    late = fault(START, "delay", "100%", 1.0)
    seen, commands = asked(tracking(late, run__dt=DT, run__seconds=12.0, timing__look_ahead=2.5))
    assert len(commands) == 7 and all(agent.counters["looked_ahead"] > 5 for agent in seen.agents.values())
    assert all(np.diff(each[:, 0]).tolist() == [1] * (len(each) - 1) for each in commands)


def test_at_a_slower_pace_a_law_is_asked_once_in_a_tick() -> None:
    seen, commands = asked(tracking(fault(START, "starve", "100%", 0.2), run__dt=0.25, run__seconds=14.0))
    assert all(agent.counters["spared"] > 10 for agent in seen.agents.values())
    for each in commands:
        assert np.diff(each[:, 0]).min() == 1 and np.diff(each[:, 0]).max() > 2
        assert 1 <= each[:, 1].min() <= each[:, 1].max() <= 8, "it is to last for some ticks"
