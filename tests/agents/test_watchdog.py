"""An agent whom the others' Hellos tell that its session is split asks for a new one, and its own Hello lists whom it really hears."""

from agents.agent import Agent
from agents.config import AgentConfig
from protocol.messages import Gossip, Hello, Observation
from protocol.node import Alive, Effect, Gone, Received, Reopen, Started, Timer, received
from protocol.sensing import SENSOR_CLASSES
from protocol.session_watchdog import FIRST_REST, PATIENCE
from protocol.settings import NetworkSettings, RunSettings

CONFIG = AgentConfig(run=RunSettings(dt=0.5), members=dict.fromkeys(("s1", "s2", "s3"), "B"))


def hello(sender: str, *heard: str) -> Received:
    return received(Hello(sender=sender, incarnation=1, sensor_class="B", sensor=SENSOR_CLASSES["B"], heard=heard))


def see(tick: int) -> Received:
    return received(Observation(sender="world", incarnation=1, recipient="s1", tick=tick, time=0.5 * tick, pose=(10.0, 20.0, 0.0)))


def word(sender: str, tick: int) -> Received:
    return received(
        Gossip(sender=sender, incarnation=1, tick=tick, pose=(60.0, 20.0, 0.0), cod=(62.0, 20.0), power_radius=2.0, unused=20.0)
    )


def met(config: AgentConfig = CONFIG) -> Agent:
    agent = Agent(config, "s1")
    agent.handle(Started(), 0.0)
    for name in ("s2", "s3"):
        agent.handle(Alive("agent", name, 1), 0.0)
        agent.handle(hello(name), 0.0)
    return agent


def run(agent: Agent, seconds: float, says: dict[str, tuple[str, ...]], speaks: tuple[str, ...]) -> list[tuple[float, Effect]]:
    """What the agent does while some say Hello every 2 s with these lists and some speak in every round of 0.5 s."""
    found: list[tuple[float, Effect]] = []
    for tick in range(int(2.0 * seconds)):
        now = 0.5 * tick
        events = [see(tick), *(word(name, tick) for name in speaks), Timer()]
        if tick % 4 == 0:
            events += [hello(name, *heard) for name, heard in says.items()]
        for event in events:
            found += [(now, effect) for effect in agent.handle(event, now)]
    return found


def test_it_asks_for_a_new_session_when_the_others_hear_whom_it_does_not_and_not_again_at_once() -> None:
    agent = met()
    found = run(agent, 20.0, {"s2": ("s1", "s3", "world")}, ("s2",))
    reopened = [(now, effect) for now, effect in found if isinstance(effect, Reopen)]
    assert [effect for _, effect in reopened] == [Reopen("the others hear s3, s1 does not")]
    assert PATIENCE <= reopened[0][0] < FIRST_REST
    assert agent.counters["reopened"] == 1


def test_it_waits_for_as_long_as_its_links_may_be_silent() -> None:
    late = AgentConfig(run=CONFIG.run, members=CONFIG.members, network=NetworkSettings(lease=30.0))
    found = run(met(late), 40.0, {"s2": ("s1", "s3", "world")}, ("s2",))
    reopened = [now for now, effect in found if isinstance(effect, Reopen)]
    assert len(reopened) == 1 and reopened[0] >= 30.0


def test_both_ends_of_a_split_session_ask_for_a_new_one() -> None:
    """One has the token of the other and hears nothing; one hears everything but sees no token any more."""
    deaf, blind = met(), met()
    assert any(isinstance(effect, Reopen) for _, effect in run(deaf, 15.0, {"s2": ("s1", "s3", "world")}, ("s2",)))
    blind.handle(Gone("agent", "s3", 1), 0.0)
    found = run(blind, 15.0, {"s2": ("s1", "s3", "world"), "s3": ("s1", "s2", "world")}, ("s2", "s3"))
    reopened = [(now, effect) for now, effect in found if isinstance(effect, Reopen)]
    assert [effect for _, effect in reopened] == [Reopen("s3 speaks, but its token has gone")]
    assert reopened[0][0] >= PATIENCE


def test_a_token_that_comes_back_and_one_of_an_older_incarnation_that_goes_late_are_no_alarm() -> None:
    back, late = met(), met()
    back.handle(Gone("agent", "s3", 1), 0.0)
    back.handle(Alive("agent", "s3", 1), 0.0)
    late.handle(Alive("agent", "s3", 2), 0.0)
    late.handle(Gone("agent", "s3", 1), 0.0)
    for agent in (back, late):
        found = run(agent, 15.0, {"s2": ("s1", "s3", "world"), "s3": ("s1", "s2", "world")}, ("s2", "s3"))
        assert not any(isinstance(effect, Reopen) for _, effect in found)


def test_its_hello_no_longer_lists_who_has_left_or_fallen_silent() -> None:
    agent = met()
    found = run(agent, 10.0, {"s2": ("s1",)}, ("s2",))
    lists = [effect.heard for _, effect in found if isinstance(effect, Hello)]
    assert lists[0] == ("s2", "s3") and lists[-1] == ("s2",)
    agent.handle(Gone("agent", "s2", 1), 10.0)
    assert [effect.heard for effect in agent.handle(Timer(), 13.0) if isinstance(effect, Hello)] == [()]
