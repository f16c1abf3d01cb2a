"""Gossips that arrive together are judged row by row: how they were cut into batches makes no difference to anybody."""

import random
from typing import Any

import msgspec
import pytest

from agents.agent import Agent
from agents.config import AgentConfig, TimingSettings
from agents.gossip.table import TOLERANCE
from agents.membership.peer_table import ACCEPTED, OWN, UNASKED, PeerTable
from protocol.message import Message
from protocol.messages import Gossip, Hello, Observation
from protocol.node import Alive, Batch, Gone, Started, Timer, received
from protocol.sensing import SENSOR_CLASSES
from tests.agents.test_peer_table import CONFIG, gossip, hear, hello, neighbours
from tests.swarm.scene import tracking

OTHERS = ("s2", "s3", "s4")


def after_a_round() -> PeerTable:
    """The peers of s1 after a round in which nobody was missing."""
    peers = neighbours(*OTHERS)
    assert peers.accept(Batch([gossip(name, 0) for name in OTHERS])) == [ACCEPTED] * 3
    assert peers.close(0) == 0
    return peers


def test_a_round_that_all_complete_is_accepted_whole() -> None:
    peers, awaited = after_a_round(), set(OTHERS)
    assert peers.accept(Batch([gossip(name, 1) for name in OTHERS]), 0, 1, awaited) == [ACCEPTED] * 3
    assert not awaited and [(name, said.sender) for name, said in peers.fresh(1).items()] == [*zip(OTHERS, OTHERS)] and not peers.missing(1)


def test_every_row_has_its_reason_and_spoils_no_other() -> None:
    peers = after_a_round()
    peers.gone("s4", 1, 0)
    rows = [
        (gossip("s1", 1), OWN),
        (gossip("s2", 1, incarnation=0), "incarnation"),
        (gossip("s2", 0), "closed"),
        (gossip("s2", 1, radius=100.0), "implausible"),
        (gossip("s9", 1), "unknown_sensor"),
        (gossip("s4", 1), "dead"),
        (gossip("s3", 1), ACCEPTED),
    ]
    assert peers.accept(Batch([said for said, _ in rows])) == [reason for _, reason in rows]
    assert list(peers.fresh(1)) == ["s3"]


def test_of_two_incarnations_in_one_batch_the_older_leaves_no_gossip_without_a_sensor_behind() -> None:
    """A peer without a token: its younger incarnation has announced no sensor yet, and nothing of the older one counts any more."""
    peers, awaited = after_a_round(), {"s2", "s3"}
    peers.gone("s2", 1, 0, suspected=True)
    batch = Batch([gossip("s2", 1), gossip("s2", 2, incarnation=2), gossip("s3", 1)])
    assert peers.accept(batch, 0, 1, awaited) == ["incarnation", "unknown_sensor", ACCEPTED]
    assert list(peers.fresh(1)) == ["s3"] and not awaited


def test_who_hears_neighbours_does_not_judge_those_whom_it_did_not_ask() -> None:
    config = msgspec.structs.replace(CONFIG, timing=TimingSettings(interest="neighbours"))
    assert PeerTable(config, "s1").accept(Batch([gossip("s2", 0), gossip("s1", 0)])) == [UNASKED, OWN]


def test_the_row_that_completes_a_round_is_the_last_that_is_judged() -> None:
    peers, awaited = after_a_round(), {"s2", "s3"}
    batch = Batch([gossip("s3", 1), gossip("s9", 1), gossip("s2", 1), gossip("s4", 1)])
    assert peers.accept(batch, 0, 1, awaited) == [ACCEPTED, "unknown_sensor", ACCEPTED] and not awaited
    assert list(peers.fresh(1)) == ["s2", "s3"]
    assert peers.accept(batch, 3, 1, None) == [ACCEPTED] and list(peers.fresh(1)) == list(OTHERS)


def test_a_younger_incarnation_in_the_same_batch_shuts_the_older_one_out() -> None:
    peers = neighbours("s2")
    peers.gone("s2", 1, 0)
    found = peers.accept(Batch([gossip("s2", 5, incarnation=2), gossip("s2", 6)]))
    assert found == ["unknown_sensor", "incarnation"]


def test_the_bounds_have_one_tolerance() -> None:
    """Class B: power radius 2.829 m at most."""
    most = (SENSOR_CLASSES["B"].area * SENSOR_CLASSES["B"].prob_detection / 3.141592653589793) ** 0.5
    for factor, reason in ((1.0, None), (1.0 + 0.4 * (TOLERANCE - 1.0), None), (1.0 + 2.0 * (TOLERANCE - 1.0), "implausible")):
        said = msgspec.structs.replace(gossip("s2", 1), power_radius=most * factor, unused=1.0)
        assert hear(neighbours("s2"), said) == reason


def test_listeners_who_were_told_of_other_sensors_judge_the_same_batch_for_themselves() -> None:
    batch, found = Batch([gossip("s2", 0, radius=15.0)]), []
    for sensor_class in "DAD":
        peers = PeerTable(CONFIG, "s1")
        peers.take_hello(hello("s2", sensor_class=sensor_class))
        found.append(peers.accept(batch))
    assert found == [[ACCEPTED], ["implausible"], [ACCEPTED]]


class Team:
    """Agents to whom the same happens, in batches that are cut by dice."""

    def __init__(self, config: AgentConfig) -> None:
        self.agents = {name: Agent(config, name) for name in config.members}
        greetings = [self.only(agent.handle(Started(), 0.0), Hello) for agent in self.agents.values()]
        for name, agent in self.agents.items():
            for other in self.agents:
                if other != name:
                    agent.handle(Alive("agent", other, 1), 0.0)
            agent.handle(received(*[hello for found in greetings for hello in found if hello.sender != name]), 0.0)

    @staticmethod
    def only(effects: list[Any], kind: type[Message]) -> list[Any]:
        return [effect for effect in effects if isinstance(effect, kind)]


def observation(name: str, tick: int) -> Observation:
    place = 10.0 + 12.0 * (len(name) + ord(name[-1]) % 7), 30.0 + tick, 0.3 * tick
    return Observation(sender="world", incarnation=1, recipient=name, tick=tick, time=0.0, pose=place)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(1, 6))])
@pytest.mark.slow
def test_how_gossips_are_cut_into_batches_changes_nothing(seed: int) -> None:
    """Some come late, twice or not at all, tokens go and come back; one team takes them one by one, the other in batches of any size."""
    dice, config = random.Random(seed), AgentConfig(members={f"s{n}": "ABC"[n % 3] for n in range(1, 7)})
    one_by_one, in_batches = Team(config), Team(config)
    late: dict[str, list[Gossip]] = {name: [] for name in config.members}
    for tick in range(25):
        now, said = 10.0 * tick, []
        for name in config.members:
            effects = [team.agents[name].handle(received(observation(name, tick)), now) for team in (one_by_one, in_batches)]
            assert effects[0] == effects[1]
            for team in (one_by_one, in_batches):  # as a driver does that is not busy: the agent asks for it
                assert team.agents[name].handle(Timer(), now) == []
            said += Team.only(effects[0], Gossip)
        for name in config.members:
            comes = late[name] + [gossip for gossip in said if gossip.sender != name and dice.random() < 0.95]
            late[name] = [gossip for gossip in said if gossip.sender != name and dice.random() < 0.05]
            comes += [gossip for gossip in comes if dice.random() < 0.05]
            dice.shuffle(comes)
            first, second = one_by_one.agents[name], in_batches.agents[name]
            alone = [effect for gossip in comes for effect in first.handle(received(gossip), now + 1.0)]
            together = []
            while comes:
                size = dice.randint(1, len(comes))
                together += second.handle(received(*comes[:size]), now + 1.0)
                comes = comes[size:]
            assert together == alone, f"seed {seed}, tick {tick}, {name}"
            assert first.handle(Timer(), now + 1.0) == second.handle(Timer(), now + 1.0)
            if dice.random() < 0.1:
                other = dice.choice([other for other in config.members if other != name])
                event = dice.choice([Gone, Alive])("agent", other, 1)
                assert first.handle(event, now + 2.0) == second.handle(event, now + 2.0)
            assert first.handle(Timer(), now + 9.0) == second.handle(Timer(), now + 9.0)
            assert first.counters == second.counters and first.peer_table.peers == second.peer_table.peers


def test_every_gossip_that_is_heard_passes_the_one_accept(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a calm run, a lossy one and a watched one, whether messages come in batches or one by one."""
    from deploy.scenario import FaultSettings
    from deploy.simulation import Simulation

    real, passed = PeerTable.accept, [0]

    def counting(self: PeerTable, *arguments: Any) -> list[str]:
        reasons = real(self, *arguments)
        passed[0] += sum(reason == ACCEPTED for reason in reasons)
        return reasons

    monkeypatch.setattr(PeerTable, "accept", counting)
    calm = tracking(run__seconds=6.0)
    lossy = msgspec.structs.replace(calm, faults=(FaultSettings(at=0.0, verb="drop", value=0.1),))
    for scenario, tapped, batches in ((calm, False, True), (lossy, False, True), (calm, True, True), (calm, False, False)):
        simulation, passed[0] = Simulation(scenario, scores=False), 0
        simulation.bus.batches = batches
        if tapped:
            simulation.bus.tap = lambda node, event: None
        simulation.run()
        heard = sum(agent.counters["heard"] for agent in simulation.agents.values())
        assert passed[0] == heard > 0
