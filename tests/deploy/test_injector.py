"""Who sees whose token after stops, freezes and cuts, and link faults that are struck by hand."""

from dataclasses import dataclass, field
from typing import Any

import msgspec
import pytest

from agents.backend import PLAIN
from deploy.faults.faults import Action
from deploy.faults.injector import RECONNECT, Injector
from deploy.faults.links import Links
from deploy.scenario import FaultSettings, resolve
from deploy.simulation import Simulation
from protocol.keys import tokens_of
from protocol.node import Alive, Effect, Event, Gone, Node, Started, Subscribe
from protocol.observer_messages import Truth
from protocol.settings import BadSetting
from protocol.virtual import VirtualBus

LEASE = 2.0  # s


@dataclass
class Witness(Node):
    """A Node that remembers the tokens of the others: whose it sees, and whose it ever saw."""

    name: str
    incarnation: int = 1
    role: str = "agent"
    run: str = "r"
    sees: set[str] = field(default_factory=set)
    saw: list[str] = field(default_factory=list)

    def handle(self, event: Event, now: float) -> list[Effect]:
        if isinstance(event, Alive):
            self.sees.add(event.name)
            self.saw.append(event.name)
        elif isinstance(event, Gone):
            self.sees.discard(event.name)
        return []

    def deadline(self) -> None:
        return None


class Subscriber(Witness):
    """One that asks for the tokens of s1 alone."""

    sees_all_tokens = False

    def handle(self, event: Event, now: float) -> list[Effect]:
        super().handle(event, now)
        return [Subscribe(tokens_of(self.run, "agent", "s1"))] if isinstance(event, Started) else []


class Team:
    """Three witnesses, s1 to s3, and what strikes them."""

    def __init__(self, kind: type[Witness] = Witness) -> None:
        scenario = resolve("quick", {"team.composition": "A3", "network.lease": LEASE})
        self.bus, links = VirtualBus(), Links(1, [*scenario.members])
        self.kind, build = kind, lambda config, name, incarnation, *others: self.kind(name, incarnation)
        self.injector = Injector(self.bus, links, scenario, PLAIN, build)  # type: ignore[arg-type]
        for name in scenario.members:
            self.injector.start(name)
        self.bus.run(0.0)

    def strike(self, verb: str, *names: str, value: float | None = None, **options: Any) -> None:
        self.injector.strike(Action(verb, [*names], value, options))

    def run(self, seconds: float) -> None:
        self.bus.run(self.bus.now + seconds)

    def sees(self) -> dict[str, set[str]]:
        """The names that each of the team sees, by label."""
        return {label: agent.sees for label, agent in self.injector.agents.items()}  # type: ignore[attr-defined]


ALL = {"s1": {"s2", "s3"}, "s2": {"s1", "s3"}, "s3": {"s1", "s2"}}


def test_after_a_long_freeze_all_see_each_other_again_but_for_one_that_is_paused_until_it_goes_on() -> None:
    team = Team()
    team.strike("pause", "s1")
    team.run(LEASE + 1.0)
    team.strike("freeze", value=LEASE + 1.0)
    team.run(LEASE + 2.0)
    assert team.sees() == {"s1": {"s2", "s3"}, "s2": {"s3"}, "s3": {"s2"}}
    team.strike("resume", "s1")
    team.run(1.0)
    assert team.sees() == ALL


def test_after_a_long_freeze_a_cut_that_is_younger_than_the_lease_keeps_its_two_sides_apart_until_it_heals() -> None:
    team = Team()
    team.strike("freeze", value=LEASE + 1.0)
    team.run(LEASE + 1.1)
    team.strike("partition", "s1")
    team.run(1.0)
    assert team.sees() == {"s1": set(), "s2": {"s3"}, "s3": {"s2"}}
    team.strike("heal")
    team.run(2.0 * RECONNECT)
    assert team.sees() == ALL


@pytest.mark.parametrize("kind", [Witness, Subscriber])
def test_who_comes_sees_no_token_of_one_that_has_been_stopped_for_the_lease(kind: type[Witness]) -> None:
    team = Team()
    team.strike("pause", "s1")
    team.run(LEASE + 1.0)
    team.kind = kind
    team.injector.kill("s3")
    team.strike("restart", "s3")
    team.run(1.0)
    back = team.injector.agents["s3"]
    assert "s1" not in back.saw  # type: ignore[attr-defined]
    team.strike("resume", "s1")
    team.run(1.0)
    assert "s1" in back.sees  # type: ignore[attr-defined]
    assert team.sees()["s1"] == {"s2", "s3"}


def test_who_comes_behind_a_cut_is_seen_when_it_heals_and_not_for_a_moment_before() -> None:
    team = Team()
    team.strike("partition", "s1")
    team.run(LEASE + 1.0)
    team.injector.kill("s3")
    team.strike("restart", "s3")
    team.run(1.0)
    assert team.injector.agents["s3"].saw == ["s2"]  # type: ignore[attr-defined]
    team.strike("heal")
    team.run(1.0)
    assert team.sees() == ALL


def test_a_bridge_is_one_that_lives() -> None:
    team = Team()
    team.strike("kill", "s1")
    team.strike("partition", "s3", kind="bridge")
    team.run(LEASE + 1.0)
    assert team.sees() == {"s2": {"s3"}, "s3": {"s2"}}


def test_a_bridge_is_one_that_is_not_paused() -> None:
    team = Team()
    team.strike("pause", "s1")
    team.strike("partition", "s3", kind="bridge")
    team.run(LEASE + 1.0)
    sees = team.sees()
    assert (sees["s2"], sees["s3"]) == ({"s3"}, {"s2"})


def test_a_link_fault_that_is_struck_by_hand_does_what_one_of_the_scenario_does() -> None:
    """Half of all messages are lost from tick 4 on; without a fault the run is another one."""
    calm = resolve("quick", {"team.composition": "A3", "run.seconds": 4.0})
    loss = FaultSettings(at=1.0, verb="drop", who="100%", value=0.5)
    listed = Simulation(msgspec.structs.replace(calm, faults=(loss,)), backend=PLAIN).run().transcript
    struck = Simulation(calm, backend=PLAIN)

    def strike(truth: Truth) -> None:
        if truth.tick == 4:
            struck.injector.strike(Action("drop", struck.injector.alive(), 0.5))

    struck.on_truth = strike
    assert struck.run().transcript == listed != Simulation(calm, backend=PLAIN).run().transcript


def test_a_simulation_with_a_link_of_its_own_refuses_other_faults_of_links() -> None:
    simulation = Simulation(resolve("quick", {"team.composition": "A3"}), link=Links(1, ["s1"]), backend=PLAIN)
    with pytest.raises(BadSetting, match=r"^drop: a simulation with a link of its own has no other faults of links$"):
        simulation.injector.strike(Action("drop", ["s1"], 0.5))
