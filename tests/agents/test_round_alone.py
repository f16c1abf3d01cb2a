"""Ticks in which no gossips are sent: an agent plays them with its own scan alone."""

import numpy as np
import pytest

from agents.agent import Agent
from agents.backend import Backend
from agents.compiled.backend import FAST
from agents.config import AgentConfig, FilterSettings
from agents.tracking.phd import predict
from agents.tracking.step import Step
from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol.fields import pack
from protocol.messages import Command, Gossip, Hello, Observation
from protocol.node import Alive, Effect, Received, Started, Timer, received
from protocol.observer_messages import Estimate
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import ArenaSettings, RunSettings

PERIOD = 0.25  # s between two ticks
TARGET = (12.0, 20.0)
CLOCK = RunSettings(dt=0.5, rate=0.5 / PERIOD, clock="realtime")


def config(kind: str = "particles") -> AgentConfig:
    return AgentConfig(
        run=CLOCK, arena=ArenaSettings(width=40.0, height=40.0), members={"s1": "A", "s2": "B"}, filter=FilterSettings(kind=kind)
    )  # type: ignore[arg-type]


def see(tick: int, *places: tuple[float, float]) -> Received:
    found = pack(np.array(places).reshape(-1, 2), "<f4")
    said = Observation(
        sender="world", incarnation=1, recipient="s1", tick=tick, time=0.5 * tick, pose=(10.0, 20.0, 0.0), detections_bytes=found
    )
    return received(said)


def hear(tick: int, pace: int) -> Received:
    """The gossip of s2, which needs that pace."""
    pose, cod = (30.0, 20.0, 0.0), (32.0, 20.0)
    return received(Gossip(sender="s2", incarnation=1, tick=tick, pose=pose, cod=cod, power_radius=2.0, unused=20.0, pace=pace))


class Swarm:
    """s1 beside a peer that needs a pace, from the end of round 0 on, in which both see the target."""

    def __init__(self, pace: int, kind: str = "particles", backend: Backend = FAST) -> None:
        self.pace = pace
        self.agent = Agent(config(kind), "s1", backend=backend)
        self.agent.handle(Started(), 0.0)
        self.agent.handle(Alive("agent", "s2", 1), 0.0)
        self.agent.handle(received(Hello(sender="s2", incarnation=1, sensor_class="B", sensor=SENSOR_CLASSES["B"])), 0.0)
        self.see(0, TARGET)
        self.hear(0)

    def see(self, tick: int, *places: tuple[float, float]) -> list[Effect]:
        """What the agent says to an observation, and as soon as that has been sent."""
        now = PERIOD * (tick + 1)
        effects = self.agent.handle(see(tick, *places), now)
        return [*effects, *(self.agent.handle(Timer(), now) if said(effects, Gossip) else [])]

    def hear(self, tick: int) -> list[Effect]:
        return self.agent.handle(hear(tick, self.pace), PERIOD * (tick + 1))


def said(effects: list[Effect], kind: type) -> list[int]:
    return [effect.tick for effect in effects if isinstance(effect, kind)]


def stated(effects: list[Effect]) -> float:
    """Expected targets within 3 m of the target, as the gossip among these effects states them."""
    [gossip] = [effect for effect in effects if isinstance(effect, Gossip)]
    assert gossip.claim_tick == 0 and gossip.claim_names[0] == "s1"
    if gossip.components_bytes:
        found = gossip.components
        return float(found["weight"][np.hypot(*(found["place"] - TARGET).T) < 3.0].sum())
    return float(gossip.weight * (np.hypot(*(gossip.states[:, :2] - TARGET).T) < 3.0).sum())


def test_the_agent_says_estimate_and_command_and_no_gossip() -> None:
    effects = Swarm(2).see(1, TARGET)
    assert said(effects, Estimate) == said(effects, Command) == [1] and not said(effects, Gossip)


@pytest.mark.parametrize("kind", ["particles", "gaussian-mixture"])
def test_the_next_gossip_states_what_the_own_scans_have_shown(kind: str) -> None:
    masses = []
    for places in ((), (TARGET,)):
        swarm = Swarm(4, kind)
        for tick in (1, 2, 3):
            swarm.see(tick, *places)
        masses.append(stated(swarm.see(4)))
    assert masses[0] < 0.2 and 0.5 < masses[1] < 1.3


def test_the_estimate_of_a_shared_round_does_not_wait_for_gossips_and_nothing_of_its_copy_is_kept() -> None:
    swarm = Swarm(2)
    swarm.see(1, TARGET)
    before = swarm.agent.outcome
    effects = swarm.see(2, TARGET)
    assert said(effects, Gossip) == said(effects, Estimate) == said(effects, Command) == [2]
    assert swarm.agent.outcome.density is before.density and swarm.agent.outcome.belief.tick == 1
    [estimate] = [effect for effect in effects if isinstance(effect, Estimate)]
    assert len(estimate.targets) == 1 and np.hypot(*(estimate.targets[0] - TARGET)) < 2.0
    effects = swarm.hear(2)
    assert not said(effects, Estimate) and not said(effects, Command), "both were in time"
    assert swarm.agent.outcome.belief.claim_tick == 2


@pytest.mark.parametrize("pace", [1, 2, 4])
def test_of_the_observations_that_wait_as_many_as_the_pace_are_enough(pace: int) -> None:
    assert Swarm(pace).agent.most_observations == pace


def test_at_a_slower_pace_the_gossip_goes_out_before_a_command_is_computed() -> None:
    swarm = Swarm(2)
    swarm.see(1, TARGET)
    effects = swarm.agent.handle(see(2, TARGET), 3 * PERIOD)
    assert [type(effect) for effect in effects] == [Gossip, Estimate] and swarm.agent.deadline() == 3 * PERIOD
    assert said(swarm.agent.handle(Timer(), 3 * PERIOD), Command) == [2]


def test_at_pace_1_an_estimate_is_that_of_the_shared_round() -> None:
    swarm = Swarm(1)
    effects = swarm.see(1, TARGET)
    assert said(effects, Gossip) == [1] and not said(effects, Estimate) and not said(effects, Command)
    assert said(swarm.hear(1), Estimate) == [1]


def test_a_scan_that_comes_while_a_round_is_open_is_played_when_it_closes() -> None:
    swarm = Swarm(2)
    swarm.see(1, TARGET)
    assert said(swarm.see(2, TARGET), Gossip) == [2]
    assert not swarm.see(3, TARGET) and swarm.agent.outcome.belief.tick == 1
    effects = swarm.hear(2)
    assert said(effects, Estimate) == said(effects, Command) == [3], "those of 2 were in time"
    assert swarm.agent.outcome.belief.tick == 3 and swarm.agent.outcome.belief.claim_tick == 2


def test_a_round_that_never_completes_is_closed_by_the_next_one_and_its_scans_are_played_before() -> None:
    swarm = Swarm(4)
    for tick in (1, 2, 3):
        swarm.see(tick, TARGET)
    assert said(swarm.see(4, TARGET), Gossip) == [4]
    for tick in (5, 6, 7):
        swarm.see(tick, TARGET)
    effects = swarm.see(8, TARGET)
    assert said(effects, Estimate) == [5, 6, 7, 8] and said(effects, Gossip) == [8]
    assert said(effects, Command) == [7, 8], "that of 4 was in time, and of 5 to 7 the last steers"
    assert swarm.agent.outcome.belief.tick == 7 and swarm.agent.outcome.belief.claim_tick == 4


def test_ticks_that_were_missed_are_played_without_a_scan() -> None:
    """A second scan makes a target likely. Two ticks without any make it no likelier, and not unlikely as two empty scans do."""
    masses = []
    for places in (None, (), (TARGET,)):
        swarm = Swarm(4)
        for tick in (1, 2) if places is not None else ():
            swarm.see(tick, *places)
        swarm.see(3, TARGET)
        assert swarm.agent.outcome.belief.tick == 3
        masses.append(stated(swarm.see(4)))
    missed, empty, seen = masses
    assert missed > 0.5 and empty < 0.5 * missed and missed < 0.95 * seen


def test_in_ticks_that_were_missed_particles_move() -> None:
    swarm = Swarm(4)
    moved = swarm.agent.outcome.density
    swarm.see(3)
    for tick in (1, 2, 3):
        moved = predict(moved, Step(swarm.agent.config, tick))
    places = dict(zip(moved.ids.tolist(), moved.states.tolist()))
    found = swarm.agent.outcome.density
    still = [(places[number], state) for number, state in zip(found.ids.tolist(), found.states.tolist()) if number in places]
    assert len(still) > 100 and all(before == after for before, after in still)


def test_an_old_observation_is_not_played() -> None:
    swarm = Swarm(4)
    swarm.see(2, TARGET)
    belief = swarm.agent.outcome.belief
    assert not said(swarm.see(1, TARGET), Command) and swarm.agent.outcome.belief is belief


def test_a_repeated_observation_and_one_that_was_overtaken_are_ignored() -> None:
    """Between two shared rounds too: a report that counts twice would seem twice as certain."""
    swarm = Swarm(4)
    swarm.see(2, TARGET)
    for tick in (2, 1, 2):
        assert swarm.see(tick, TARGET) == []
    assert swarm.agent.counters["rejected.old_observation"] == 3 and swarm.agent.counters["spared"] == 1


def test_a_claim_is_kept_no_longer_than_peers_keep_the_generator() -> None:
    """Peers keep the generator of a silent agent for 4 rounds of this pace, or a second: 16 ticks."""
    swarm = Swarm(4)
    assert said(swarm.see(15, TARGET), Command) == [15]
    late = Swarm(4)
    assert not said(late.see(17, TARGET), Command) and late.agent.outcome.belief.tick == 0


def test_particles_stay_in_the_cell_of_the_last_round() -> None:
    swarm = Swarm(4)
    for tick in (1, 2, 3):
        swarm.see(tick, TARGET)
    belief, round_cell = swarm.agent.outcome.belief, swarm.agent.outcome.round_cell
    assert round_cell is not None and belief.mine.claim is round_cell.region.claim
    assert (belief.mine.targets.states[:, 0] <= round_cell.region.polygon[:, 0].max() + 1e-6).all()
    moved = swarm.agent.context.tracker.keep_claim(belief, Step(swarm.agent.config, 5))
    assert moved.tick == 4 and moved.claim_tick == 0 and len(moved.copies.skipped_steps) == len(belief.copies.skipped_steps) + 1
    states = moved.mine.targets.states
    assert len(states) and np.array_equal(states, states.astype(np.float32))  # receivers of the next gossip hold the same ones


def test_ticks_of_which_nothing_was_seen_keep_the_particles_that_enter_the_cell() -> None:
    """A swarm whose mass must not change, at a pace of 8. One agent sees no observation of a tick between."""
    options = {"team.composition": "L6", "targets.count": 0, "detection.clutter": 0.0, "filter.lifetime": 0.0, "filter.border": "reflect"}
    options |= {"filter.prior_density": 0.01, "birth.background": False, "birth.measurement": False, "run.seconds": 30.0, "run.rate": 1.0}
    options |= {"arena.width": 40.0, "arena.height": 40.0, "sensors.L.angle": 240.0, "sensors.L.radius": 8.0}
    simulation = Simulation(resolve("efficacy", {**options, "sensors.L.prob_detection": 1e-12}), clock="realtime")
    for agent in simulation.agents.values():
        agent._pace.close = lambda tick, needs, pace=agent._pace: setattr(pace, "current", 8)  # type: ignore[method-assign]
    simulation.agents["s2"]._take_gossip_free = lambda observation: None  # type: ignore[method-assign]
    simulation.run()
    masses = [score.mass for score in simulation.scorer.scores]
    assert min(masses[16::8]) > 0.999 * masses[0]
