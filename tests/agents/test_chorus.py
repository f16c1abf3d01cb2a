"""What all who hear the same share: who is answered, and that it goes with its round."""

import gc

from agents.arithmetic import PLAIN
from agents.chorus import Chorus, chorus_of
from agents.config import AgentConfig, TimingSettings
from agents.words import Words, learn
from deploy.simulation import Simulation
from protocol.geometry import rectangle
from protocol.messages import Gossip
from protocol.sensing import SENSOR_CLASSES
from tests.swarm.scene import tracking

ARENA = rectangle(40.0, 40.0)


def words(*names: str, listening: bool = False) -> Words:
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
    for gossip in said:
        learn(gossip, SENSOR_CLASSES["A"], AgentConfig())
    return Words.of_gossips(said, bytearray().join([gossip.memo["row"] for gossip in said]))


def test_the_first_works_for_itself_and_the_others_share() -> None:
    said, config = words("s1", "s2", "s3"), AgentConfig()
    assert [chorus_of(said, "s2", PLAIN, config, ARENA) for _ in range(2)] == [None, None]
    shared = chorus_of(said, "s3", PLAIN, config, ARENA)
    assert isinstance(shared, Chorus)
    assert chorus_of(said, "s1", PLAIN, config, ARENA) is chorus_of(said, "s2", PLAIN, config, ARENA) is shared
    cells = [PLAIN.cut(place, said.points, said.radii, ARENA) for place in range(3)]
    assert [cell.polygon.tolist() for cell in shared.parts.cells] == [cell.polygon.tolist() for cell in cells]
    assert [claim.names[0] for claim in shared.parts.claims] == ["s1", "s2", "s3"]


def test_another_configuration_shares_nothing_with_it() -> None:
    said, config, other = words("s1", "s2"), AgentConfig(), AgentConfig()
    chorus_of(said, "s1", PLAIN, config, ARENA)
    shared = chorus_of(said, "s2", PLAIN, config, ARENA)
    assert chorus_of(said, "s2", PLAIN, other, ARENA) is not shared


def test_newcomers_and_those_who_hear_a_part_work_for_themselves() -> None:
    for said, config in (
        (words("s1", "s2", listening=True), AgentConfig()),
        (words("s1", "s2"), AgentConfig(timing=TimingSettings(interest="neighbours"))),
    ):
        assert [chorus_of(said, name, PLAIN, config, ARENA) for name in ("s1", "s2", "s1")] == [None] * 3


def test_what_is_shared_goes_with_its_round() -> None:
    """Without the help of the search for cycles: it is rarely made in a simulation."""
    gc.collect()
    gc.disable()
    try:
        simulation = Simulation(tracking(run__seconds=8.0))
        simulation.run()
        alive = sum(isinstance(thing, Words) for thing in gc.get_objects())
    finally:
        gc.enable()
    assert alive < 10
