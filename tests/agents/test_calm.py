"""Gossips read together are taken, refused and played as one by one, whatever lies among them and whatever happens between."""

import random
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.agent import Agent
from agents.arithmetic import PLAIN
from agents.calm import CalmRound, Expected, Roll
from agents.config import AgentConfig, PartitionSettings, TimingSettings
from agents.fast import FAST
from agents.neighbours import Neighbours
from agents.words import Words, eye_of, learn, side_by_side
from protocol import codec
from protocol.fields import Malformed, pack
from protocol.keys import matches, message_key
from protocol.messages import Beacon, Gossip, Hello, Message, Observation
from protocol.node import Alive, Event, Gone, Received, Rejected, Started, Subscribe, Timer, Unsubscribe
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import ArenaSettings, sensor_of
from tests.protocol.test_codec_fuzz import mutate

MEMBERS = dict(zip(("s1", "s2", "s3", "s10", "s11"), "ABCDE"))
CONFIG = AgentConfig(members=MEMBERS)
TICK = 7
Wire = tuple[str, bytes]


def gossip(dice: random.Random, name: str, tick: int = TICK, **fields: Any) -> Gossip:
    """What a peer could say."""
    count, seen, bounds = dice.choice([0, 1, 5, 60]), dice.choice([0, 0, 1, 4]), dice.choice([1, 2, 20])
    sensor = SENSOR_CLASSES[MEMBERS[name]]
    east, north = dice.uniform(10.0, 90.0), dice.uniform(10.0, 90.0)
    names = (name, *(f"s{20 + n}" for n in range(bounds - 1))) if count or dice.random() < 0.7 else ()
    rows = np.array([[dice.uniform(0.0, 100.0) for _ in range(4)] for _ in range(max(count, seen, bounds))])
    ids = np.array(sorted(dice.sample(range(1, 2**63), count)), dtype=np.uint64)
    said = {
        "sender": name,
        "incarnation": 1,
        "tick": tick,
        "pose": (east, north, dice.uniform(-4.0, 4.0)),
        "cod": (east + dice.uniform(-1.0, 1.0), north),
        "power_radius": dice.uniform(0.0, 1.0),
        "unused": dice.uniform(0.0, 1.0) * sensor.area * sensor.prob_detection,
        "detections_bytes": pack(rows[:seen, :2], "<f4"),
        "scanned": dice.random() < 0.8,
        "claim_tick": max(0, tick - 1),
        "claim_names": names,
        "claim_bytes": pack(rows[: len(names), :3], "<f8"),
        "view": dice.choice([5, 5, 2**40]),
        "weight": dice.uniform(0.0, 1.0) if count else 0.0,
        "states_bytes": pack(rows[:count], "<f4"),
        "ids_bytes": pack(ids, "<u8"),
    }
    return Gossip(**(said | fields))


def wire(said: Gossip) -> Wire:
    return message_key(CONFIG.run.name, said), codec.encode(said)


def roll(config: AgentConfig = CONFIG, without: str = "s3") -> Roll:
    """All members but one, whose row is left free."""
    assert FAST.reader is not None
    facts = Neighbours(config, without)
    for name, sensor_class in MEMBERS.items():
        if name != without:
            facts.greet(Hello(sender=name, incarnation=1, sensor_class=sensor_class))
    expected = []
    for name, peer in facts.peers.items():
        assert peer.outfit is not None
        eye = eye_of(name, peer.outfit.sensor, config.detection.clutter)
        expected.append(Expected(name, 1, eye, peer.outfit.facts.capability, peer.outfit.sensor.reach))
    return Roll(config, FAST.reader, expected, list(MEMBERS).index(without))


def read(batch: list[Wire]) -> CalmRound | None:
    reading = CalmRound(roll(), TICK)
    return reading if reading.read(*zip(*batch)) is not None else None


def one_by_one(gossips: list[Gossip], config: AgentConfig = CONFIG) -> Words:
    for said in gossips:
        learn(said, sensor_of(config, MEMBERS[said.sender]), config)
    return side_by_side(gossips)


def assert_same(found: Words, wanted: Words) -> None:
    assert found.names == wanted.names and found.claimed == wanted.claimed and found.listening == wanted.listening
    assert found.table.tobytes() == wanted.table.tobytes() and found.view == wanted.view and found.all_wedges == wanted.all_wedges
    assert found.detections.tobytes() == wanted.detections.tobytes() and found.detections.shape == wanted.detections.shape
    for a, b in zip((*found.stated, *found.particles), (*wanted.stated, *wanted.particles)):
        assert a.tobytes() == b.tobytes() and a.shape == b.shape and a.dtype == b.dtype
    assert found.gossips == wanted.gossips


@pytest.mark.parametrize("kind", ["power", "voronoi", "voronoi-cod"])
def test_the_words_of_a_calm_round_are_those_of_its_gossips(kind: str) -> None:
    config = AgentConfig(members=MEMBERS, partition=PartitionSettings(kind=kind))  # type: ignore[arg-type]
    for seed in range(40):
        dice = random.Random(seed)
        gossips = [gossip(dice, name) for name in MEMBERS]
        mine = gossips[2]
        batch = [wire(said) for said in gossips if said is not mine]
        dice.shuffle(batch)
        reading = CalmRound(roll(config), TICK)
        cut = dice.randint(1, 3)
        for part in (batch[:cut], batch[cut:]):
            names = reading.read(*zip(*part))
            assert names is not None and [f"/{name}" for name in names] == [key[key.rindex("/") :] for key, _ in part], f"seed {seed}"
        learn(mine, SENSOR_CLASSES["C"], config)
        assert_same(reading.words(mine), one_by_one(gossips, config))
        assert list(reading) == ["s1", "s2", "s10", "s11"] and list(reading.gossips()) == list(reading)


ODD: dict[str, dict[str, Any]] = {
    "another tick": {"tick": TICK + 1},
    "another incarnation": {"incarnation": 2},
    "no cell yet": {"listening": True},
    "more unused capacity than there is": {"unused": 1e5},
    "a power radius beyond its sensor": {"power_radius": 100.0},
    "a COD beyond reach": {"cod": (0.0, 0.0), "pose": (90.0, 90.0, 0.0)},
    "a number that is none": {"weight": float("nan")},
    "a negative weight": {"weight": -1e-9},
    "a place that is nowhere": {"pose": (float("inf"), 0.0, 0.0)},
    "a particle that is nowhere": {"states_bytes": pack(np.array([[1.0, np.nan, 1.0, 1.0]]), "<f4"), "ids_bytes": bytes(8)},
    "a detection that is nowhere": {"detections_bytes": pack(np.array([[1.0, np.inf]]), "<f4")},
    "half a detection": {"detections_bytes": bytes(4)},
    "ids that fall": {
        "states_bytes": bytes(32),
        "ids_bytes": pack(np.array([9, 3]), "<u8"),
        "claim_names": ("s2",),
        "claim_bytes": bytes(24),
    },
    "fewer ids than particles": {"states_bytes": bytes(32), "ids_bytes": bytes(8)},
    "a claim of the future": {"claim_tick": TICK},
    "somebody else's claim": {"claim_names": ("s1",), "claim_bytes": bytes(24)},
    "a claim without numbers": {"claim_names": ("s2",), "claim_bytes": b""},
    "particles without a claim": {"states_bytes": bytes(16), "ids_bytes": bytes(8), "claim_names": (), "claim_bytes": b""},
    "a whole number for a real one": {"weight": 1},
    "another's name": {"sender": "s1"},
    "another wire": {"wire": 2},
    "a name not of ASCII": {"claim_names": ("s2", "\u00e9"), "claim_bytes": bytes(48)},
}


@pytest.mark.parametrize("odd", ODD)
def test_what_is_out_of_the_ordinary_is_left_to_be_read_alone(odd: str) -> None:
    dice = random.Random(3)
    good, base = wire(gossip(dice, "s1")), gossip(dice, "s2")
    assert read([good, wire(base)]) is not None
    bad = message_key(CONFIG.run.name, base), msgspec.msgpack.encode(msgspec.structs.replace(base, **ODD[odd]))
    assert read([good, bad]) is None and read([bad]) is None


def test_a_stranger_a_second_word_and_bytes_too_many_are_left_to_be_read_alone() -> None:
    dice = random.Random(4)
    key, payload = wire(gossip(dice, "s1"))
    assert read([(key, payload), (key, payload)]) is None
    assert read([(f"{key}9", payload)]) is None and read([("covey/other/gossip/s1", payload)]) is None
    assert read([(key, payload + b"\xc0")]) is None and read([(key, payload[:-1])]) is None and read([(key, b"")]) is None
    reading = read([(key, payload)])
    assert reading is not None and reading.read([key], [payload]) is None and len(reading) == 1
    assert reading.read(*zip(wire(gossip(dice, "s2")))) is not None and len(reading) == 2


def test_whatever_bytes_the_reader_takes_the_decoder_and_the_neighbours_take_with_the_same_values() -> None:
    dice, taken, changed = random.Random(11), 0, 0
    names = [name for name in MEMBERS if name != "s3"]
    for number in range(6000):
        key, payload = wire(gossip(dice, dice.choice(names)))
        mutated = mutate(dice, payload)
        reading = read([(key, mutated)])
        if reading is not None:
            said = codec.decode(key, mutated)  # raises what the reader should have seen
            assert isinstance(said, Gossip), f"message {number}"
            mine = gossip(dice, "s3")
            learn(mine, SENSOR_CLASSES["C"], CONFIG)
            others = {name: gossip(dice, name) for name in names if name != said.sender}
            assert reading.read(*zip(*map(wire, others.values()))) is not None
            everybody = {said.sender: said, "s3": mine, **others}
            assert_same(reading.words(mine), one_by_one([everybody[name] for name in MEMBERS]))
            assert believed(said), f"message {number}"
            taken, changed = taken + 1, changed + (mutated != payload)
    assert changed > 100 and taken < 3000


def believed(said: Gossip) -> bool:
    judge = Neighbours(CONFIG, "s3")
    judge.alive(said.sender, 1)
    judge.greet(Hello(sender=said.sender, incarnation=1, sensor_class=MEMBERS[said.sender]))
    return judge.hear(said) is None


# ---------------------------------------------------------------------- whole rounds


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
        event = Rejected(key, found.reason, key, payload) if isinstance(found, Malformed) else Received(found, len(payload), payload)
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
                twins.tell(Received(hello), 0.0)
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
        twins.tell(Received(Hello(sender=other, incarnation=1, sensor=SENSOR_CLASSES[dice.choice("AEH")])), now)


@pytest.mark.parametrize("rate", [0.0, 0.03, 0.2])
@pytest.mark.parametrize("seed", range(4))
def test_an_agent_that_reads_together_says_and_remembers_what_one_does_that_reads_one_by_one(seed: int, rate: float) -> None:
    dice, swarm, ticks = random.Random(100 * seed + int(100 * rate)), crew(), 40
    for tick in range(ticks):
        now = 10.0 * tick
        seen = [name for name in swarm if dice.random() >= 0.5 * rate]  # the others do not hear of this tick
        said = {name: swarm[name].tell(Received(observation(dice, name, tick)), now) for name in seen}
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
            said[name] += twins.tell(Received(seen), now)
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
                twins.tell(Received(beacon), now)


def test_plain_arithmetic_reads_one_by_one() -> None:
    assert PLAIN.reader is None
    assert Agent(CONFIG, "s1").hear_all([], [], 0.0) is None
