"""Swarms whose bodies are participants of their own, in virtual time: no node is called world."""

import itertools
import math
import statistics

import msgspec
import pytest

from agents.compiled.backend import FAST
from deploy.scenario import Scenario, resolve
from deploy.simulation import Simulation
from protocol.message import Message
from protocol.messages import Command, Gossip, Halt, Hello, Observation
from protocol.node import Alive, Effect, Event, Node, Started, Stop, Timer, received
from protocol.random_streams import random_key
from tests.swarm.scene import fault, ledger
from world.body import Body

LEDGER = {
    "arena.width": 40.0,
    "arena.height": 40.0,
    "team.composition": "E8",
    "targets.border": "reflect",
    "filter.border": "reflect",
}


def swarm(host: str, clock: str = "realtime", **settings: object) -> Simulation:
    scenario: Scenario = resolve("quick", {**LEDGER, "run.seconds": 20.0, "bodies.host": host, **settings})
    return Simulation(scenario, clock=clock, backend=FAST)  # type: ignore[arg-type]


def play(simulation: Simulation, seconds: float) -> None:
    simulation.bus.run(simulation.bus.now + seconds)


def bodies(simulation: Simulation) -> dict[str, Body]:
    endpoints = simulation.bus._endpoints.values()
    return {endpoint.node.name: endpoint.node for endpoint in endpoints if isinstance(endpoint.node, Body)}


def poses(simulation: Simulation) -> dict[str, tuple[float, ...]]:
    return {name: body.pose for name, body in bodies(simulation).items()}


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
@pytest.mark.parametrize(
    "seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=[pytest.mark.slow, pytest.mark.nightly])]
)
def test_bodies_of_their_own_walk_the_way_of_one_world_to_the_last_bit(clock: str, seed: int) -> None:
    together, alone = (swarm(host, clock, **{"run.seed": seed}).run() for host in ("world", "own"))
    assert alone.transcript == together.transcript
    assert (alone.ticks, alone.mean_ospa, alone.hole_area) == (together.ticks, together.mean_ospa, together.hole_area)


def test_a_body_counts_the_ticks_that_ended_before_their_command_came() -> None:
    late = msgspec.structs.replace(swarm("own").scenario, faults=(fault(5.0, "pause", "s3", seconds=2.0),))
    simulation = Simulation(late, clock="realtime", backend=FAST)
    play(simulation, 18.0)
    counts = {name: body.ticks_without_command for name, body in bodies(simulation).items()}
    assert counts.pop("s3") == 8 and set(counts.values()) == {0}


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_a_restarted_agent_is_not_waited_for_before_it_has_been_asked(clock: str) -> None:
    simulation = swarm("own", clock)
    play(simulation, 6.0)
    body = Body(bodies(simulation)["s3"]._config, "s3", 1)
    for event in (Started(), *(Alive(role, name, 1) for name in simulation.agents for role in ("agent", "body"))):
        body.handle(event, 0.0)
    hellos = [Hello(sender=name, incarnation=1, heard=tuple(simulation.agents)) for name in simulation.agents]
    effects = [effect for hello in hellos for effect in body.handle(received(hello), 0.0)]
    assert [effect.tick for effect in effects if isinstance(effect, Observation)] == [0]
    restarted = [*body.handle(Alive("agent", "s3", 2), 0.01), *body.handle(received(Hello(sender="s3", incarnation=2)), 0.02)]
    assert [effect.tick for effect in restarted if isinstance(effect, Observation)] == ([1] if clock == "lockstep" else [])
    body.handle(Timer(), body._clock.due(1) if clock == "realtime" else 5.0)
    assert body.ticks_without_command == 0 and body.tick >= 1


def test_no_node_is_called_world_and_no_truth_is_sent() -> None:
    simulation = swarm("own")
    assert simulation.bus.nodes() == ["monitor", *(f"s{n}.body" for n in range(1, 9)), *(f"s{n}" for n in range(1, 9))]
    kinds: set[str] = set()
    publish = simulation.bus._publish
    simulation.bus._publish = lambda endpoint, message: (kinds.add(type(message).__name__), publish(endpoint, message))[1]  # type: ignore
    simulation.run()
    assert kinds == {"Hello", "Gossip", "Observation", "Command", "Estimate"}


@pytest.mark.slow
def test_clocks_50_ms_apart_are_no_event() -> None:
    simulation = swarm("own", **{"bodies.epoch": 2.0})
    for number, name in enumerate(bodies(simulation)):
        simulation.bus.jump(f"{name}.body", 0.05 * (-1) ** number)
    simulation.bus.run(2.0)
    assert {body.tick for body in bodies(simulation).values()} == {-1, 0}  # half of them are ahead
    result = simulation.run()
    assert all(body._clock.corrections == 0 for body in bodies(simulation).values())
    assert result.ticks == 80
    assert result.steady_ospa <= 1.1 * swarm("world").run().steady_ospa


@pytest.mark.parametrize("step", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_a_clock_that_steps_by_a_second_is_set_right_by_the_neighbours_and_moves_no_other(step: float) -> None:
    simulation = swarm("own")
    play(simulation, 5.0)
    simulation.bus.jump("s3.body", step)
    play(simulation, 3.0)
    ticks = {name: body.tick for name, body in bodies(simulation).items()}
    assert max(ticks.values()) - min(ticks.values()) <= 1
    corrections = {name: body._clock.corrections for name, body in bodies(simulation).items()}
    assert corrections.pop("s3") >= 1 and set(corrections.values()) == {0}
    result = simulation.run()
    assert result.ticks == 80 and simulation.scorer.scores[-1].hole <= 1e-6


def test_a_body_that_comes_late_begins_with_the_tick_of_the_others() -> None:
    simulation = swarm("own", **{"run.start_timeout": 1.0})
    late = simulation.bus.remove("s5.body", notice_after=None)
    simulation.bus.run(6.0)
    others = {body.tick for body in bodies(simulation).values()}
    assert len(others) == 1 and others.pop() > 10
    assert isinstance(late, Body)
    simulation.bus.add(Body(late._config, "s5", 2), "s5.body")
    play(simulation, 1.0)
    assert len({body.tick for body in bodies(simulation).values()}) == 1
    play(simulation, 2.0)
    assert simulation.scorer.scores[-1].hole <= 1e-6
    assert simulation.agents["s5"].counters["rounds"] > 0


def test_after_the_deaths_of_two_bodies_and_an_agent_the_rest_cover_the_arena_within_a_second_and_nobody_else_stops() -> None:
    simulation = swarm("own")
    play(simulation, 8.0)
    for label in ("s2.body", "s5.body"):
        simulation.bus.remove(label)
    simulation.injector.kill("s7")
    tick = bodies(simulation)["s1"].tick
    before = poses(simulation)
    play(simulation, 3.0)
    closed = [score.tick for score in simulation.scorer.scores if score.tick > tick and score.hole <= 1e-6]
    assert closed and closed[0] <= tick + 4
    after = poses(simulation)
    assert {name for name in after if after[name] != before[name]} == {"s1", "s3", "s4", "s6", "s8"}
    assert {body.tick for body in bodies(simulation).values()} == {tick + 12}


PROCESSES = [f"s{number}{kind}" for number in range(1, 9) for kind in ("", ".body")]
TRIPLES = sorted(itertools.combinations(PROCESSES, 3), key=lambda names: random_key(27, "triple", *names))  # all 560 of them, shuffled


@pytest.mark.slow
@pytest.mark.parametrize(
    "share",
    [slice(0, 8), pytest.param(slice(8, None), marks=[pytest.mark.nightly, pytest.mark.timeout(1800)])],
    ids=["some", "the rest"],
)
def test_after_the_deaths_of_any_three_processes_the_hole_is_closed_within_a_second_no_mass_is_lost_and_nobody_else_stops(
    share: slice,
) -> None:
    given = ledger(run__seconds=8.0, bodies__host="own", control__mode="random")
    closings, masses = [], []
    for killed in TRIPLES[share]:
        simulation = Simulation(given, clock="realtime", backend=FAST)
        play(simulation, 4.0)
        for name in killed:
            simulation.bus.remove(name) if name.endswith(".body") else simulation.injector.kill(name)
        tick = max(body.tick for body in bodies(simulation).values())
        play(simulation, 2.0)
        whole = [score.tick for score in simulation.scorer.scores if score.tick > tick and score.hole <= 1e-6]
        later = [score.mass / 16.0 for score in simulation.scorer.scores if score.tick >= whole[0]]
        closings.append(whole[0] - tick)
        masses += later
        assert whole[0] <= tick + 4 and min(later) >= 0.99 and len(whole) == len(later), killed
        assert later[-1] <= 1.01, killed  # the last word of an agent without a body counts for a second, beside that of its heirs
        driven = {name for name, body in bodies(simulation).items() if body._driven_until is not None}
        assert driven == {f"s{number}" for number in range(1, 9)} - {name.partition(".")[0] for name in killed}, killed
        assert {body.tick for body in bodies(simulation).values()} == {tick + 8}, killed
    print(f"{len(closings)} triples: closed after {max(closings)} ticks at most; mass {min(masses):.4f} to {max(masses):.4f}")


@pytest.mark.parametrize("how", ["killed", "stopped"])
def test_a_body_stands_within_half_a_second_of_its_agents_last_command(how: str) -> None:
    simulation = swarm("own")
    play(simulation, 6.0)
    body = bodies(simulation)["s3"]
    assert body._driven_until is not None
    if how == "killed":
        simulation.injector.kill("s3")
        assert simulation.bus.step(simulation.bus.now)
    else:
        simulation.bus.pause("s3")
    play(simulation, 0.5)
    assert body._driven_until is None
    there = body.pose
    play(simulation, 1.0)
    assert body.pose == there and body.tick > 24


class Operator(Node):
    """Says one order."""

    run, role = "covey", "operator"

    def __init__(self, held: bool, incarnation: int) -> None:
        self.name, self.incarnation = f"operator-{incarnation}", incarnation
        self._order = Halt(sender=self.name, incarnation=incarnation, held=held)

    def handle(self, event: Event, now: float) -> list[Effect]:
        return [self._order, Stop(0, "said")] if isinstance(event, Started) else []

    def deadline(self) -> float | None:
        return None


@pytest.mark.parametrize("host", ["own", "world"])
def test_a_halt_holds_every_body_until_it_is_released_and_the_swarm_goes_on_tracking(host: str) -> None:
    simulation = swarm(host)
    play(simulation, 4.0)
    simulation.bus.add(Operator(held=True, incarnation=5))
    play(simulation, 0.5)
    held = simulation.scorer.truth
    play(simulation, 3.0)
    assert simulation.scorer.truth.tick == held.tick + 12
    assert simulation.scorer.truth.poses_bytes == held.poses_bytes
    simulation.bus.add(Operator(held=False, incarnation=4))  # older than the halt
    play(simulation, 1.0)
    assert simulation.scorer.truth.poses_bytes == held.poses_bytes
    simulation.bus.add(Operator(held=False, incarnation=6))
    play(simulation, 1.0)
    assert (simulation.scorer.truth.poses != held.poses).any(axis=1).all()


def test_a_halt_makes_both_sides_of_a_partition_stand_within_half_a_second() -> None:
    parted = msgspec.structs.replace(swarm("own").scenario, faults=(fault(3.0, "partition", "s1,s2,s3,s4", seconds=15.0),))
    simulation = Simulation(parted, clock="realtime", backend=FAST)
    play(simulation, 6.0)
    before = poses(simulation)
    play(simulation, 1.0)
    assert all(pose != before[name] for name, pose in poses(simulation).items())
    simulation.bus.add(Operator(held=True, incarnation=5))
    play(simulation, 0.5)
    held = poses(simulation)
    play(simulation, 2.0)
    assert poses(simulation) == held and all(body.tick > 36 for body in bodies(simulation).values())


def test_of_two_bodies_of_one_agent_the_older_one_stops_and_the_others_go_on() -> None:
    simulation = swarm("own")
    play(simulation, 4.0)
    simulation.bus.add(Body(bodies(simulation)["s3"]._config, "s3", 2), "s3.body2")
    play(simulation, 2.0)
    assert simulation.bus.stopped["s3.body"] == Stop(3, "a younger body 2 of s3 is alive")
    ticks = {body.tick for body in bodies(simulation).values()}
    assert len(ticks) == 1 and ticks.pop() >= 23


def test_an_epoch_says_when_the_first_tick_is() -> None:
    simulation = swarm("own", **{"bodies.epoch": 7.0})
    play(simulation, 6.9)
    assert {body.tick for body in bodies(simulation).values()} == {-1}
    play(simulation, 0.2)
    assert {body.tick for body in bodies(simulation).values()} == {0}


def test_no_body_is_driven_out_of_the_fence() -> None:
    simulation = swarm("own", **{"bodies.fence": 0.0, "control.mode": "random", "bodies.start": "uniform"})
    simulation.run()
    for estimate in simulation.scorer._latest.values():
        assert -1e-9 <= estimate.pose[0] <= 40.0 + 1e-9 and -1e-9 <= estimate.pose[1] <= 40.0 + 1e-9
    assert math.isfinite(simulation.scorer.scores[-1].ospa)


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_clocks_50_ms_apart_and_messages_up_to_20_ms_late_cost_less_than_a_tenth_of_the_ospa() -> None:
    """The median of ten seeds; the ratio is that to a run driven by one world, without delays."""
    ratios, everybody = [], ",".join(f"s{number}" for number in range(1, 9))
    for seed in range(1, 11):
        scenario = swarm("own", **{"run.seed": seed, "bodies.epoch": 2.0}).scenario
        late = msgspec.structs.replace(scenario, faults=(fault(0.0, "delay", everybody, value=0.001, jitter=0.02),))
        simulation = Simulation(late, clock="realtime", backend=FAST)
        for number, name in enumerate(bodies(simulation)):
            simulation.bus.jump(f"{name}.body", 0.05 * (-1) ** number)
        ratios.append(simulation.run().steady_ospa / swarm("world", **{"run.seed": seed}).run().steady_ospa)
        assert all(body._clock.corrections == 0 for body in bodies(simulation).values())
    print(f"ratios {min(ratios):.4f} to {max(ratios):.4f}, median {statistics.median(ratios):.4f}")
    assert statistics.median(ratios) <= 1.1


def test_a_body_in_lockstep_that_hears_the_others_begin_first_waits_for_word_of_its_own_agent() -> None:
    simulation, said = swarm("own", "lockstep"), list[Message]()
    publish = simulation.bus._publish
    simulation.bus._publish = lambda endpoint, message: (said.append(message), publish(endpoint, message))[1]  # type: ignore
    while not any(isinstance(message, Command) for message in said):
        simulation.bus.step()
    body = Body(bodies(simulation)["s3"]._config, "s3", 1)
    body.handle(Started(), 0.0)
    for name in simulation.agents:
        body.handle(Alive("agent", name, 1), 0.0)
        body.handle(Alive("body", name, 1), 0.0)
    gossips = [message for message in said if isinstance(message, Gossip) and message.sender != "s3"]
    assert len(gossips) == 7
    assert not [effect for gossip in gossips for effect in body.handle(received(gossip), 0.1)]
    own = [message for message in said if isinstance(message, Hello) and message.sender == "s3"]
    [observation] = body.handle(received(own[-1]), 0.2)
    assert isinstance(observation, Observation) and observation.tick == 0
    later = body.handle(Timer(), 5.0)  # the round takes longer than a tick of real time
    assert not later and body.tick == 0 and body.ticks_without_command == 0
