"""Gossips of tests as a round's table, all sent by the same sensor unless said otherwise."""

from collections.abc import Sequence

from agents.config import AgentConfig
from agents.gossip.table import GossipTable, announced_sensor, gossip_table
from protocol.messages import Gossip
from protocol.sensing import SENSOR_CLASSES, SensorModel


def table(
    gossips: Sequence[Gossip],
    sensor: SensorModel = SENSOR_CLASSES["A"],
    config: AgentConfig = AgentConfig(),
    sensors: Sequence[SensorModel] = (),
) -> GossipTable:
    """The table of a round in which these were said."""
    carried = sensors or [sensor] * len(gossips)
    found = [announced_sensor(gossip.sender, each, config.detection.clutter) for gossip, each in zip(gossips, carried)]
    return gossip_table(list(gossips), found, config)
