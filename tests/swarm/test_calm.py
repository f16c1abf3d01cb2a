"""Without faults: the cells tile the arena in every tick, nothing is lost or counted twice, and nobody hears what is not for agents."""

import pytest

from deploy.simulation import Simulation
from protocol.keys import matches
from tests.swarm.scene import BLIND, fault, ledger, tracking, watch


@pytest.mark.parametrize("partition", ["power", "voronoi", "voronoi-cod"])
def test_the_cells_tile_the_arena_and_all_views_agree_in_every_tick(partition: str) -> None:
    seen = watch(tracking(partition__kind=partition))
    assert len(seen.holes) == 80
    assert max(seen.holes) == 0.0 and max(seen.overlaps) == 0.0
    assert set(seen.views) == {1}


@pytest.mark.parametrize("dt", [0.25, 5.0, 10.0])
def test_every_command_comes_in_time_however_long_a_tick_is(dt: float) -> None:
    simulation = watch(tracking(run__dt=dt, run__seconds=8.0 * dt)).simulation
    assert simulation.world.ticks_without_command == 0
    starts = Simulation(simulation.scenario).world.bodies.poses
    assert simulation.world.bodies.poses != starts


def test_the_mass_that_agents_report_is_the_sum_of_the_particles_they_publish() -> None:
    result = watch(tracking()).result
    assert result.mass_residual < 1e-9 < result.mean_ospa


def test_nothing_is_gained_or_lost_when_nothing_is_born_or_detected() -> None:
    masses = watch(ledger()).masses
    assert masses[0] == pytest.approx(0.01 * 40.0 * 40.0)
    assert max(abs(mass - masses[0]) for mass in masses) < 1e-6


def test_no_particle_is_owned_by_two_agents_and_all_lie_in_the_cells_of_their_owners() -> None:
    def check(tick: int, simulation: Simulation) -> None:
        stated = [agent.outcome.belief.mine for agent in simulation.agents.values()]
        ids = [number for each in stated for number in each.targets.ids.tolist()]
        assert len(ids) == len(set(ids)) and (tick < 2 or len(ids) > 200)

    watch(tracking(), at_tick=check)


def test_no_agent_can_hear_the_truth_an_estimate_or_what_is_for_another_agent() -> None:
    seen = watch(tracking(run__seconds=2.0))
    run = seen.simulation.scenario.run.name
    forbidden = [f"covey/{run}/truth", f"covey/{run}/estimate/s1", f"covey/{run}/estimate/s9", f"covey/{run}/command/s1"]
    for name in seen.agents:
        expressions = seen.simulation.bus._endpoints[name].expressions
        others = [f"covey/{run}/observation/{other}" for other in seen.agents if other != name]
        assert not [key for key in [*forbidden, *others] for expression in expressions if matches(expression, key)]
        assert any(matches(expression, f"covey/{run}/observation/{name}") for expression in expressions)


def test_a_newcomer_is_in_every_view_half_a_second_after_its_listening_rounds() -> None:
    views: dict[int, set[frozenset[str]]] = {}

    def look(tick: int, simulation: Simulation) -> None:
        views[tick] = {frozenset(agent.peer_table.peers) | {name} for name, agent in simulation.agents.items()}

    seen = watch(ledger(fault(5.0, "join", "s20", **{"class": "L"})), at_tick=look)
    assert "s20" not in seen.living[19] and "s20" in seen.living[23]
    there = min(tick for tick, found in views.items() if found == {frozenset(seen.agents)})
    share = min(seen.masses) / seen.masses[0]
    print(f"in every view when the tick {0.25 * there - 5.0:.2f} s after its start begins; mass {share:.4f} at least")
    assert set(seen.views[seen.at(5.0 + 0.5 + 0.5) :]) == {1}
    assert views[79] == {frozenset(seen.agents)}
    assert min(seen.masses) >= 0.99 * seen.masses[0] and max(seen.masses) <= 1.01 * seen.masses[0]


def test_a_swarm_of_one_owns_the_arena() -> None:
    seen = watch(ledger(agents=1, side=20.0, sensors__L={**BLIND, "radius": 5.0}))
    assert max(seen.holes) == 0.0 and max(abs(mass - 4.0) for mass in seen.masses) < 1e-6
