"""What a table keeps for all agents that hold it: for which requests it is computed, and that it goes with its round."""

import gc

from agents.backend import PLAIN
from agents.batched_round import BatchedRound, batched_round
from agents.config import AgentConfig, TimingSettings
from agents.gossip.table import GossipTable
from agents.tracking.belief import ParticlePhd
from agents.tracking.step import Step
from deploy.simulation import Simulation
from protocol.geometry import rectangle
from protocol.messages import Gossip
from tests.agents.gossip_table import table as table_of
from tests.swarm.scene import tracking

ARENA = rectangle(40.0, 40.0)


def words(*names: str, listening: bool = False) -> GossipTable:
    """What some say, side by side."""
    said = [
        Gossip(
            sender=name,
            incarnation=1,
            tick=1,
            pose=(4.0 * place, 5.0, 0.0),
            cod=(4.0 * place, 5.0),
            power_radius=1.0,
            unused=4.0,
            listening=listening,
        )
        for place, name in enumerate(names)
    ]
    return table_of(said)


def asked(table: GossipTable, config: AgentConfig, tick: int = 1) -> BatchedRound | None:
    """What an agent gets that asks for what the table keeps."""
    return batched_round(table, PLAIN, ParticlePhd(PLAIN), Step(config, tick), ARENA)


def test_the_first_that_asks_computes_its_region_alone_and_the_others_share_all() -> None:
    table, config = words("s1", "s2", "s3"), AgentConfig()
    assert asked(table, config) is None
    shared = asked(table, config)
    assert isinstance(shared, BatchedRound) and asked(table, config) is asked(table, config) is shared
    cells = PLAIN.cut_cells(range(3), table.generators, ARENA)
    assert [region.polygon.tolist() for region in shared.regions] == [cell.polygon.tolist() for cell in cells]
    assert [region.claim.names[0] for region in shared.regions] == [region.owner for region in shared.regions] == ["s1", "s2", "s3"]
    assert len(shared.updates) == 3


def test_in_the_tick_after_a_batched_round_the_first_that_asks_computes_all_regions() -> None:
    config, first = AgentConfig(), words("s1", "s2")
    others = [GossipTable(first.gossips, first.sensors, first.config) for _ in range(4)]
    assert asked(first, config, 1) is None and asked(others[0], config, 2) is None
    assert asked(others[0], config, 2) is not None
    assert asked(others[1], AgentConfig(), 3) is None and asked(others[2], config, 4) is None
    assert asked(others[3], config, 3) is not None


def test_the_same_gossips_in_another_table_are_asked_for_anew() -> None:
    table, config = words("s1", "s2"), AgentConfig()
    others = [GossipTable(table.gossips, table.sensors, table.config) for _ in range(3)]
    assert [asked(other, config) for other in others] == [None] * 3


def test_another_configuration_or_tick_shares_nothing_with_it() -> None:
    table, config = words("s1", "s2"), AgentConfig()
    asked(table, config)
    shared = asked(table, config)
    assert shared is not None and asked(table, AgentConfig()) is not shared
    assert asked(table, config, 2) is not asked(table, config, 1)


def test_newcomers_and_those_who_hear_a_part_work_for_themselves() -> None:
    for table, config in (
        (words("s1", "s2", listening=True), AgentConfig()),
        (words("s1", "s2"), AgentConfig(timing=TimingSettings(interest="neighbours"))),
    ):
        assert [asked(table, config) for _ in range(3)] == [None] * 3


def test_what_is_shared_goes_with_its_round() -> None:
    """Without the help of the search for cycles: it is rarely made in a simulation."""
    gc.collect()
    gc.disable()
    try:
        simulation = Simulation(tracking(run__seconds=8.0))
        simulation.run()
        alive = sum(isinstance(thing, GossipTable) for thing in gc.get_objects())
    finally:
        gc.enable()
    assert alive < 10
