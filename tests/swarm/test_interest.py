"""Who hears its neighbours only does what it would do if it heard everybody, to the last bit, and survives what all survive."""

from dataclasses import dataclass, field

import msgspec
import pytest

from agents.membership.peer_table import COMPLETE_SET_HASH
from agents.round import COPY_DISTANCE
from agents.tracking.belief import Copies
from deploy.bench.simulations import crowd
from deploy.scenario import FaultSettings, Scenario, resolve
from deploy.simulation import Simulation
from protocol.geometry import distances, polygon_area, polygon_centroid
from protocol.keys import all_of
from protocol.messages import Beacon
from protocol.node import Effect, Event, Node, Started, Subscribe, messages_of
from protocol.observer_messages import Estimate
from tests.swarm.scene import Listener, ledger, tracking, watch


@dataclass
class Beacons(Node):
    """A Node that keeps all beacons."""

    run: str
    name: str = "beacons"
    role: str = "recorder"
    incarnation: int = 1
    beacons: list[Beacon] = field(default_factory=list)

    def handle(self, event: Event, now: float) -> list[Effect]:
        self.beacons += [message for message in messages_of(event) if isinstance(message, Beacon)]
        return [Subscribe(all_of(self.run, "beacon"))] if isinstance(event, Started) else []

    def deadline(self) -> float | None:
        return None


def large(seed: int, team: str, interest: str, *faults: FaultSettings, seconds: float = 30.0) -> Scenario:
    options = {"team.composition": team, "run.dt": 0.5, "run.seconds": seconds, "run.seed": seed, "timing.interest": interest}
    return msgspec.structs.replace(resolve("efficacy", options), faults=faults)


def play(scenario: Scenario) -> tuple[Simulation, list[tuple[object, ...]]]:
    """A run, and of every agent in every tick its pose, capacity, load, mass, targets and labels, bit for bit.

    The area and the first moments of its cell are equal to 1e-6: a generator that cuts off a corner which another cuts off anyway may
    change the last bit of a cell.
    """
    simulation, listener = Simulation(scenario), Listener(scenario.run.name)
    simulation.bus.add(listener)
    simulation.run()
    return simulation, [
        (tick, name, said.pose, *cell_of(said), said.unused, said.load, said.mass, said.targets_bytes, said.labels_bytes)
        for tick, estimates in sorted(listener.estimates.items())
        for name, said in sorted(estimates.items())
    ]


def farthest_copy(interest: str) -> float:
    """The longest way from a cell to a copy that its agent holds, m; the arena is 141 m across."""
    simulation, _ = play(large(1, "20E+10G", interest, seconds=10.0))
    ways = []
    for agent in simulation.agents.values():
        belief = agent.outcome.belief
        assert isinstance(belief.copies, Copies)
        if len(agent.outcome.cell):
            ways.append(float(distances(agent.outcome.cell, belief.copies.compute().states[:, :2]).max()))
    return max(ways)


@pytest.mark.slow
def test_who_hears_its_neighbours_keeps_no_copies_beyond_the_horizon() -> None:
    assert farthest_copy("neighbours") <= COPY_DISTANCE < 0.5 * farthest_copy("all")


def cell_of(said: Estimate) -> tuple[float, ...]:
    if not len(said.cell):
        return 0.0, 0.0, 0.0
    return tuple(round(float(number), 6) for number in (polygon_area(said.cell), *polygon_centroid(said.cell)))


@pytest.mark.parametrize(
    "team, seed", [pytest.param("4", 1, marks=pytest.mark.nightly), ("20E+10G", 2), pytest.param("A24,B24", 3, marks=pytest.mark.nightly)]
)
@pytest.mark.slow
@pytest.mark.nightly
def test_hearing_the_neighbours_alone_gives_the_bits_of_hearing_all(team: str, seed: int) -> None:
    print(f"seed {seed}")
    (_, everything), (simulation, all_the_same) = (play(large(seed, team, interest)) for interest in ("all", "neighbours"))
    assert everything == all_the_same
    heard = [len(agent.peer_table.interest_set) for agent in simulation.agents.values()]
    assert sum(heard) < 0.6 * len(heard) * (len(heard) - 1)


def test_who_hears_nobody_that_measures_bearings_plays_as_if_it_did() -> None:
    """A few sensors measure range and bearing; of the positions that the others measure all make the same particles."""
    camera = {"angle": 120.0, "radius": 10.0, "prob_detection": 0.9, "measures": "range-bearing", "range_noise": 0.3, "bearing_noise": 2.0}
    runs = []
    for interest in ("all", "neighbours"):
        options = {"team.composition": "E20,P2", "run.dt": 0.5, "run.seconds": 10.0, "timing.interest": interest, "sensors.P": camera}
        runs.append(play(resolve("efficacy", options)))
    (_, everything), (simulation, all_the_same) = runs
    assert everything == all_the_same
    assert any(not agent.peer_table.interest_set.keys() & {"s21", "s22"} for agent in simulation.agents.values())


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(4, 12))
def test_it_does_so_for_many_seeds(seed: int) -> None:
    (_, everything), (_, all_the_same) = (play(large(seed, "4", interest, seconds=100.0)) for interest in ("all", "neighbours"))
    assert everything == all_the_same


@pytest.mark.slow
def test_who_owns_nothing_agrees_with_all_the_others() -> None:
    """Whom it does not know could only take from it; so nobody has to look for an overlap of its claim with his own."""
    simulation = Simulation(crowd(120, "neighbours", 20), scores=False)
    listener = Listener(simulation.scenario.run.name)
    simulation.bus.add(listener)
    simulation.run()
    said = [one for tick, estimates in listener.estimates.items() if tick > 0 for one in estimates.values()]
    unsure = [one for one in said if one.diagram_hash != COMPLETE_SET_HASH]
    assert [one.tick for one in unsure if not len(one.cell)] == [] and len(unsure) < 0.01 * len(said)


@pytest.mark.slow
def test_the_dead_are_taken_over_and_a_restarted_agent_gets_a_cell() -> None:
    faults = (FaultSettings(at=5.0, verb="kill", who="s3,s7,s11"), FaultSettings(at=10.0, verb="restart", who="s3,s7,s11"))
    simulation = Simulation(large(5, "20E+10G", "neighbours", *faults, seconds=25.0))
    result = simulation.run()
    assert [kill.closed_ticks is not None and kill.closed_ticks <= 2 for kill in result.kills] == [True] * 3
    assert all(score.hole < 1e-6 and score.overlap < 1e-6 for score in simulation.scorer.scores[-10:])
    assert len(simulation.agents) == 30


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_sensor_wider_than_all_of_the_team_joins_without_an_overlap(seed: int) -> None:
    """Nobody was told of class D: it sees three times as far as those who are there, and its cell is the largest."""
    scenario = large(seed, "A6,C8", "neighbours", FaultSettings(at=10.0, verb="join", who="s99", options={"class": "D"}), seconds=40.0)
    simulation = Simulation(scenario)
    simulation.run()
    after = [score for score in simulation.scorer.scores if score.time > 10.0]
    assert [score.time for score in after if max(score.hole, score.overlap) > 1e-6] == []
    assert len(simulation.agents["s99"].outcome.cell) and len(simulation.agents) == 15


@pytest.mark.slow
def test_all_are_told_of_the_widest_sensor_though_most_never_hear_it() -> None:
    faults = (FaultSettings(at=5.0, verb="join", who="s99", options={"class": "D"}),)
    scenario = large(3, "A10,C14", "neighbours", *faults, seconds=20.0)
    arena = msgspec.structs.replace(scenario.arena, width=160.0, height=160.0)
    simulation, told = Simulation(msgspec.structs.replace(scenario, arena=arena)), Beacons(scenario.run.name)
    simulation.bus.add(told)
    simulation.run()
    last = {beacon.sender: beacon.widest_reach for beacon in told.beacons if beacon.tick > 30}
    assert last == dict.fromkeys(simulation.agents, 25.0)
    came = next(number for number, beacon in enumerate(told.beacons) if beacon.sender == "s99")
    assert {beacon.widest_reach for beacon in told.beacons[:came]} == {8.0}


@pytest.mark.slow
def test_mass_is_kept_when_agents_die() -> None:
    """In a swarm that sees nothing the mass of 16 targets is only moved about."""
    faults = (FaultSettings(at=6.0, verb="kill", who="s2,s9,s17"),)
    seen = watch(ledger(*faults, agents=24, side=120.0, run__seconds=15.0, timing__interest="neighbours"))
    assert seen.masses[-1] == pytest.approx(seen.masses[5], rel=0.01)


@pytest.mark.slow
def test_who_has_no_cell_keeps_the_copies_with_which_it_takes_over_from_the_dead() -> None:
    """While some agents of the team own nothing, a third of all die: those who get a cell now know all that the dead knew."""
    faults = (FaultSettings(at=4.0, verb="kill", who="30%"),)
    everything, neighbours = (watch(large(4, "4", interest, *faults, seconds=5.5)) for interest in ("all", "neighbours"))
    assert neighbours.masses == pytest.approx(everything.masses, rel=1e-9)


@pytest.mark.slow
@pytest.mark.nightly
def test_with_loss_the_mass_stays() -> None:
    faults = (FaultSettings(at=2.0, verb="loss", value=0.2),)
    seen = watch(ledger(*faults, agents=24, side=120.0, run__seconds=15.0, timing__interest="neighbours"))
    assert seen.masses[-1] == pytest.approx(seen.masses[3], rel=0.03)


@pytest.mark.slow
def test_small_teams_hear_all_they_need() -> None:
    alike = [watch(tracking(timing__interest=interest)).result for interest in ("all", "neighbours")]
    assert alike[0] is not None and alike[1] is not None and alike[0].transcript == alike[1].transcript
