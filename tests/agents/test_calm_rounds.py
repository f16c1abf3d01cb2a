"""Agents that read together say and remember what those do that read one by one, whatever lies among it and whatever happens between."""

import random
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from agents.agent import Agent
from agents.config import AgentConfig, TimingSettings
from agents.fast import FAST
from protocol import codec
from protocol.fields import Malformed, pack
from protocol.keys import matches, message_key
from protocol.messages import Beacon, Gossip, Hello, Message, Observation
from protocol.node import Alive, Event, Gone, Rejected, Started, Subscribe, Timer, Unsubscribe, received
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import ArenaSettings
from tests.agents.test_calm import CONFIG, MEMBERS, Wire, wire
from tests.protocol.test_codec_fuzz import mutate


@dataclass
class Twins:
    """Two agents of a name to whom the same happens; only the first may read together."""

    first: Agent
    second: Agent
    refused: int = 0
    late: list[Wire] = field(default_factory=list)  # what comes after its round
    wanted: set[str] = field(default_factory=set)  # to what they subscribe

    def tell(self, event: Event, now: float) -> list[Message]:
        effects, others = self.first.handle(event, now), self.second.handle(event, now)
        return self.agreed(effects, others)

    def bring(self, batch: list[Wire], now: float) -> list[Message]:
        if not batch:
            return []
        effects = self.first.hear_all(*zip(*batch), now)
        if effects is None:
            self.refused += 1
            effects = alone(self.first, batch, now)
        return self.agreed(effects, alone(self.second, batch, now))

    def agreed(self, effects: list[Any], others: list[Any]) -> list[Message]:
        assert effects == others
        messages = [(effect, other) for effect, other in zip(effects, others) if isinstance(effect, Message)]
        assert [codec.encode(effect) for effect, _ in messages] == [codec.encode(other) for _, other in messages]
        assert self.first.deadline() == self.second.deadline() and self.first.awaiting == self.second.awaiting
        subscribed(effects, self.wanted)
        return [effect for effect, _ in messages]

    def compare(self) -> None:
        one, other = self.first, self.second
        assert one.counters == other.counters and one.neighbours.peers == other.neighbours.peers
        assert list(one.neighbours.peers) == list(other.neighbours.peers) and one.neighbours.circle == other.neighbours.circle
        mine, other_words = one._presence._words, other._presence._words  # who hears neighbours does not listen to those whom it leaves
        assert mine == other_words or (one.local and mine.keys() <= other_words.keys())
        if one.local:
            tables = [agent.neighbours.places.table(bytes(48))[:-1].tobytes() for agent in (one, other)]
            assert tables[0] == tables[1] and one.neighbours.places.names == other.neighbours.places.names


def subscribed(effects: list[Any], wanted: set[str]) -> None:
    """Follow the subscriptions among the effects."""
    for effect in effects:
        if isinstance(effect, Subscribe):
            wanted.add(effect.expression)
        elif isinstance(effect, Unsubscribe):
            wanted.discard(effect.expression)


def alone(agent: Agent, batch: list[Wire], now: float) -> list[Any]:
    effects = []
    for (key, payload), found in zip(batch, codec.decode_all(batch)):
        event = Rejected(key, found.reason, key, payload) if isinstance(found, Malformed) else received(found, len(payload), payload)
        effects += agent.handle(event, now)
    return effects


def crew(config: AgentConfig = CONFIG) -> dict[str, Twins]:
    found = {name: Twins(Agent(config, name, 1, FAST), Agent(config, name, 1, FAST)) for name in config.members}
    hellos = []
    for name, twins in found.items():
        for other in config.members:
            if other != name and not twins.first.local:
                twins.tell(Alive("agent", other, 1), 0.0)
        hellos += [message for message in twins.tell(Started(), 0.0) if isinstance(message, Hello)]
    for name, twins in found.items():
        for hello in hellos:
            if hello.sender != name and not hello.local:
                twins.tell(received(hello), 0.0)
    return found


def observation(dice: random.Random, name: str, tick: int) -> Observation:
    east, north = dice.uniform(30.0, 70.0), dice.uniform(30.0, 70.0)
    dots = np.array([[east + dice.gauss(0.0, 4.0), north + dice.gauss(0.0, 4.0)] for _ in range(dice.randrange(4))]).reshape(-1, 2)
    pose = (east, north, dice.uniform(-3.0, 3.0))
    return Observation(sender="world", incarnation=1, recipient=name, tick=tick, time=0.0, pose=pose, detections_bytes=pack(dots, "<f4"))


def spoil(dice: random.Random, twins: Twins, batch: list[Wire]) -> list[Wire]:
    """One of a batch comes late, twice, or mutated."""
    kind, place = dice.randrange(3), dice.randrange(len(batch))
    if kind == 0:
        twins.late.append(batch[place])
        return [*batch[:place], *batch[place + 1 :]]
    if kind == 1:
        return [*batch, batch[place]]
    return [*batch[:place], (batch[place][0], mutate(dice, batch[place][1])), *batch[place + 1 :]]


def disturb(dice: random.Random, name: str, twins: Twins, now: float) -> None:
    """A token goes and comes back, perhaps of a younger incarnation that nobody is; or somebody announces another sensor."""
    other, kind = dice.choice([other for other in MEMBERS if other != name]), dice.randrange(3)
    if kind == 0:
        twins.tell(Gone("agent", other, 1), now)
    elif kind == 1:
        twins.tell(Alive("agent", other, 1), now)
    else:
        twins.tell(received(Hello(sender=other, incarnation=1, sensor=SENSOR_CLASSES[dice.choice("AEH")])), now)


@pytest.mark.parametrize("rate", [0.0, 0.03, 0.2])
@pytest.mark.parametrize("seed", range(4))
def test_an_agent_that_reads_together_says_and_remembers_what_one_does_that_reads_one_by_one(seed: int, rate: float) -> None:
    dice, swarm, ticks = random.Random(100 * seed + int(100 * rate)), crew(), 40
    for tick in range(ticks):
        now = 10.0 * tick
        seen = [name for name in swarm if dice.random() >= 0.5 * rate]  # the others do not hear of this tick
        said = {name: swarm[name].tell(received(observation(dice, name, tick)), now) for name in seen}
        spoken = [wire(message) for messages in said.values() for message in messages if isinstance(message, Gossip)]
        for name, twins in swarm.items():
            batch = [(key, payload) for key, payload in spoken if not key.endswith(f"/{name}")]
            dice.shuffle(batch)
            batch = spoil(dice, twins, batch) if batch and dice.random() < rate else batch
            cut = dice.randint(0, len(batch))
            twins.bring([*twins.late[:-1], *batch[:cut]], now + 1.0)
            twins.late = twins.late[-1:]
            if dice.random() < rate:
                disturb(dice, name, twins, now + 1.5)
            twins.bring(batch[cut:], now + 2.0)
            twins.tell(Timer(), now + 9.0)
            twins.compare()
    rounds = len(swarm) * ticks
    together = 2 * rounds - sum(twins.refused for twins in swarm.values())
    assert together > (1.8 * rounds if rate == 0.0 else 0.2 * rounds)


MANY = {f"s{number}": "AB"[number % 2] for number in range(1, 25)}
WIDE = AgentConfig(members=MANY, arena=ArenaSettings(width=150.0, height=150.0), timing=TimingSettings(interest="neighbours"))


@pytest.mark.parametrize("rate", [0.0, 0.05])
def test_so_it_is_with_agents_that_hear_their_neighbours_only(rate: float) -> None:
    dice, swarm, ticks = random.Random(int(100 * rate)), crew(WIDE), 60
    places = {name: (dice.uniform(10.0, 140.0), dice.uniform(10.0, 140.0), dice.uniform(0.0, 6.0)) for name in swarm}
    read_together = taken = 0
    for tick in range(ticks):
        now, said = 10.0 * tick, {name: [] for name in swarm}  # type: dict[str, list[Message]]
        for name, twins in swarm.items():
            x, y, heading = places[name]
            places[name] = (min(149.0, max(1.0, x + dice.gauss(0.3, 1.0))), min(149.0, max(1.0, y + dice.gauss(0.0, 1.0))), heading + 0.1)
            seen = Observation(sender="world", incarnation=1, recipient=name, tick=tick, time=0.0, pose=places[name])
            said[name] += twins.tell(received(seen), now)
        for part in range(12 if tick == 0 else 0):  # they ask who is there
            for name, twins in swarm.items():
                said[name] += twins.tell(Timer(), now + 0.2 * part)
                spread(swarm, name, said[name], now + 0.2 * part)
        spoken = [wire(message) for messages in said.values() for message in messages if isinstance(message, Gossip)]
        for name, twins in swarm.items():
            # Who is not needed speaks first: after the round it may count as heard, too late. And what it says is not looked at.
            spare = [(key, payload) for key, payload in spoken if key in twins.wanted and key in spare_of(twins)]
            batch = [(key, payload) for key, payload in spoken if key in twins.wanted and key not in spare_of(twins)]
            dice.shuffle(batch)
            batch = [*spare, *(spoil(dice, twins, batch) if batch and dice.random() < rate else batch)]
            before = twins.refused
            follow_up = twins.bring(batch, now + 3.0) + twins.tell(Timer(), now + 9.0)
            read_together, taken = read_together + (twins.refused == before), taken + 1
            spread(swarm, name, follow_up, now + 9.0)
            twins.compare()
    assert read_together > (0.7 if rate == 0.0 else 0.4) * taken
    assert any(twins.first.neighbours.circle.keys() != MANY.keys() - {name} for name, twins in swarm.items())


def spare_of(twins: Twins) -> frozenset[str]:
    """The keys of gossips that come and are not needed."""
    lookout = twins.first._lookout
    assert lookout is not None
    return lookout.spare


def spread(swarm: dict[str, Twins], sender: str, said: list[Message], now: float) -> None:
    """Let those hear beacons who listen where they are said; they are taken out of what was said."""
    for beacon in [message for message in said if isinstance(message, Beacon)]:
        said.remove(beacon)
        for name, twins in swarm.items():
            key = message_key(WIDE.run.name, beacon)
            if name != sender and any(matches(expression, key) for expression in twins.wanted if "/beacon/" in expression):
                twins.tell(received(beacon), now)
