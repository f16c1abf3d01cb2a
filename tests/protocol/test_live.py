"""The live driver over real Zenoh sessions on loopback: two nodes talk, tokens come and go, garbage is counted, codes are kept."""

import asyncio
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from agents.agent import Agent
from agents.config import AgentConfig
from protocol import keys, live
from protocol.endpoints import free_port
from protocol.link_faults import LiveLink
from protocol.message import Message
from protocol.messages import Command
from protocol.node import Alive, Effect, Event, Gone, Node, Rejected, Reopen, Started, Stop, Subscribe, Timer, Unsubscribe, messages_of
from protocol.settings import BadSetting, NetworkSettings, RunSettings

pytestmark = pytest.mark.live
ROOT = Path(__file__).parents[2]


class Scribe(Node):
    """A node that writes down every event and does what it is told at the start."""

    role = "agent"

    def __init__(self, name: str, *first: Effect, incarnation: int = 1) -> None:
        self.run = f"t{free_port()}"
        self.name = name
        self.incarnation = incarnation
        self.events: list[Event] = []
        self.first = list(first)
        self.next: float | None = None

    def handle(self, event: Event, now: float) -> list[Effect]:
        self.events.append(event)
        return self.first if isinstance(event, Started) else []

    def deadline(self) -> float | None:
        return self.next

    def texts(self) -> list[Message]:
        return [message for event in self.events for message in messages_of(event)]


def command(sender: str, tick: int) -> Command:
    return Command(sender=sender, incarnation=1, tick=tick, velocity=(1.0, 2.0), turn_rate=0.5)


async def until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait for a condition; fails after `seconds`, a bound that only a broken driver reaches."""
    async with asyncio.timeout(seconds):
        while not condition():
            await asyncio.sleep(0.005)


class Pair:
    """Two drivers in one loop, the second dialling the first; both gone at the end."""

    def __init__(self, left: Scribe, right: Scribe, most_per_second: int = 1000, link: LiveLink | None = None) -> None:
        right.run = left.run
        port = free_port()
        listen = f"tcp/127.0.0.1:{port}"
        self.endpoint = listen
        self.drivers = [
            live.Driver(left, NetworkSettings(listen=(listen,), most_per_second=most_per_second), link),
            live.Driver(right, NetworkSettings(seeds=(listen,))),
        ]

    async def __aenter__(self) -> "Pair":
        self.tasks = [asyncio.create_task(driver.serve()) for driver in self.drivers]
        return self

    async def __aexit__(self, *_: object) -> None:
        for driver in self.drivers:
            driver.stop(0, "the test is over")
        await asyncio.gather(*self.tasks, return_exceptions=True)


def test_two_nodes_hear_each_other_but_not_themselves_and_see_each_others_token() -> None:
    async def scene() -> None:
        left = Scribe("a")
        left.first = [Subscribe(keys.all_of(left.run, "command"))]
        right = Scribe("b")
        right.first = [Subscribe(keys.all_of(left.run, "command"))]
        async with Pair(left, right) as pair:
            await until(lambda: Alive("agent", "b", 1) in left.events and Alive("agent", "a", 1) in right.events)
            for tick in range(1, 200):
                for driver, name in zip(pair.drivers, "ab"):
                    driver._carry_out(command(name, tick))
                await asyncio.sleep(0.005)
                if left.texts() and right.texts():
                    break
            pair.drivers[1].stop(0, "leaves")
            await until(lambda: Gone("agent", "b", 1) in left.events)
            assert await pair.tasks[1] == 0
        assert {message.sender for message in left.texts()} == {"b"}
        assert {message.sender for message in right.texts()} == {"a"}
        assert left.texts()[0] == command("b", left.texts()[0].tick)  # type: ignore[attr-defined]
        assert left.events.count(Alive("agent", "b", 1)) == 1

    asyncio.run(scene())


def test_garbage_is_rejected_counted_and_quarantined_without_silencing_the_agent_under_whose_key_it_comes() -> None:
    async def scene() -> None:
        left, right = Scribe("a"), Scribe("b")
        left.first = [Subscribe(keys.all_of(left.run, "command"))]
        async with Pair(left, right) as pair:
            await until(lambda: Alive("agent", "b", 1) in left.events)
            stranger = await asyncio.to_thread(live.open_session, NetworkSettings(seeds=(pair.endpoint,)))
            key = keys.one_of(left.run, "command", "b")

            def quarantined() -> bool:
                stranger.put(key, b"\xc1 garbage")
                pair.drivers[1]._carry_out(command("b", 7))
                return Rejected("b", "quarantine") in left.events

            await until(quarantined)
            before = len(left.texts())
            await until(lambda: bool(pair.drivers[1]._carry_out(command("b", 8))) or len(left.texts()) > before)
            await asyncio.to_thread(stranger.close)
        assert left.events.count(Rejected("b", "format")) == 20
        assert pair.drivers[0].counts["rejected"] == 20
        assert pair.drivers[0].counts["quarantined"] == left.events.count(Rejected("b", "quarantine"))

    asyncio.run(scene())


def test_a_node_that_stops_gives_the_exit_code_and_an_error_in_a_node_ends_the_driver() -> None:
    async def scene() -> None:
        assert await live.Driver(Scribe("a", Stop(3, "fenced off")), NetworkSettings()).serve() == 3

        class Broken(Scribe):
            def handle(self, event: Event, now: float) -> list[Effect]:
                raise ZeroDivisionError("in the node")

        with pytest.raises(ZeroDivisionError, match="in the node"):
            await live.Driver(Broken("a"), NetworkSettings()).serve()

    asyncio.run(scene())


def test_a_timer_comes_at_the_deadline_and_not_before() -> None:
    class Clock(Scribe):
        def handle(self, event: Event, now: float) -> list[Effect]:
            self.events.append(event)
            if isinstance(event, Timer):
                assert self.next is not None and now >= self.next
                return [Stop(0, "three rounds")] if len(self.events) == 4 else self.again(now)
            return self.again(now)

        def again(self, now: float) -> list[Effect]:
            self.next = now + 0.01
            return []

    node = Clock("a")
    assert live.run(node, NetworkSettings()) == 0
    assert node.events == [Started(), Timer(), Timer(), Timer()]


def test_unsubscribing_ends_delivery_only_after_as_many_times_as_subscribing() -> None:
    async def scene() -> None:
        left, right = Scribe("a"), Scribe("b")
        expression = keys.all_of(left.run, "command")
        left.first = [Subscribe(expression), Subscribe(expression), Unsubscribe(expression)]
        async with Pair(left, right) as pair:
            await until(lambda: bool(pair.drivers[1]._carry_out(command("b", 1))) or bool(left.texts()))
            pair.drivers[0]._carry_out(Unsubscribe(expression))
            assert not pair.drivers[0]._subscribers

    asyncio.run(scene())


@pytest.mark.slow
def test_a_session_that_is_opened_anew_keeps_its_subscriptions_and_reports_nobody_who_is_still_there() -> None:
    async def scene() -> None:
        left, right = Scribe("a"), Scribe("b")
        expression = keys.all_of(left.run, "command")
        left.first, right.first = [Subscribe(expression)], [Subscribe(expression)]
        async with Pair(left, right) as pair:
            await until(lambda: Alive("agent", "b", 1) in left.events and Alive("agent", "a", 1) in right.events)
            for number, driver in enumerate(pair.drivers):  # the first listens on a port of its own, and so must do again
                before = list(left.events), list(right.events)
                driver._carry_out(Reopen("for the test"))
                other = (right, left)[number]
                token = Alive("agent", "ab"[number], 1)
                await until(lambda: other.events.count(token) == 2)  # noqa: B023
                for sender, hearer in ((0, right), (1, left)):
                    heard = len(hearer.texts())
                    say = command("ab"[sender], 1)
                    await until(lambda: bool(pair.drivers[sender]._carry_out(say)) or len(hearer.texts()) > heard)  # noqa: B023
                await until(lambda: driver._reopening is not None and driver._reopening.done())  # noqa: B023
                assert driver.counts["reopened"] == 1
                mine = (left, right)[number].events[len(before[number]) :]
                assert not [event for event in mine if isinstance(event, Gone)]

    asyncio.run(scene())


def test_a_session_that_does_not_let_go_of_its_port_is_opened_anew_on_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "RETRY_SECONDS", 0.05)

    async def scene() -> None:
        left, right = Scribe("a"), Scribe("b")
        left.first = [Subscribe(keys.all_of(left.run, "command"))]
        both = Pair(left, right)
        other = f"tcp/127.0.0.1:{free_port()}"
        ends = ((left, both.endpoint, other), (right, other, both.endpoint))
        both.drivers = [live.Driver(node, NetworkSettings(listen=(own,), seeds=(seed,))) for node, own, seed in ends]
        async with both as pair:
            await until(lambda: Alive("agent", "b", 1) in left.events)
            driver, stuck = pair.drivers[0], []

            async def hang(declared: object = None) -> None:
                stuck.append((driver._session, declared))
                driver._session = None

            with monkeypatch.context() as patch:
                patch.setattr(driver, "_close", hang)
                driver._carry_out(Reopen("for the test"))
                await until(lambda: driver.counts["reopened"] == 1)
            heard = len(left.texts())
            await until(lambda: bool(pair.drivers[1]._carry_out(command("b", 1))) or len(left.texts()) > heard)
            for session, _ in stuck:
                if session is not None:
                    await asyncio.to_thread(session.close)

    asyncio.run(scene())


def test_a_session_that_fails_after_its_subscriptions_leaves_none_behind_and_the_next_one_hears(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "RETRY_SECONDS", 0.05)

    async def scene() -> None:
        left, right = Scribe("a"), Scribe("b")
        left.first = [Subscribe(keys.all_of(left.run, "command"))]
        async with Pair(left, right) as pair:
            await until(lambda: Alive("agent", "b", 1) in left.events)
            driver, fails = pair.drivers[0], [live.zenoh.ZError("for the test")]
            declare = driver._declare

            def failing() -> None:
                if fails:
                    raise fails.pop()
                declare()

            monkeypatch.setattr(driver, "_declare", failing)
            driver._carry_out(Reopen("for the test"))
            await until(lambda: driver.counts["reopened"] == 1)
            assert not fails
            heard = len(left.texts())
            await until(lambda: bool(pair.drivers[1]._carry_out(command("b", 1))) or len(left.texts()) > heard)

    asyncio.run(scene())


def test_who_is_not_there_any_more_after_the_session_was_opened_anew_is_reported_gone() -> None:
    async def scene() -> None:
        left, right = Scribe("a"), Scribe("b")
        async with Pair(left, right) as pair:
            await until(lambda: Alive("agent", "b", 1) in left.events)
            pair.drivers[0]._tokens.see(keys.token_key(left.run, "agent", "ghost", 1), True)
            pair.drivers[0]._carry_out(Reopen("for the test"))
            await until(lambda: Gone("agent", "ghost", 1) in left.events)

    asyncio.run(scene())


@pytest.mark.slow
def test_three_agents_of_whom_two_cannot_find_each_other_are_brought_together_by_their_watchdogs(monkeypatch: pytest.MonkeyPatch) -> None:
    """A split that is made by settings: the first sessions of s1 and s2 dial s3 alone and do not listen to its gossip of peers."""

    async def scene() -> None:
        config = AgentConfig(run=RunSettings(name=f"t{free_port()}"), members=dict.fromkeys(("s1", "s2", "s3"), "A"))
        agents = [Agent(config, name) for name in config.members]
        meeting = f"tcp/127.0.0.1:{free_port()}"
        networks = [NetworkSettings(seeds=(meeting,))] * 2 + [NetworkSettings(listen=(meeting,))]
        drivers = [live.Driver(agent, network) for agent, network in zip(agents, networks)]
        values = live.session_values
        deaf = {**values(networks[0]), "scouting/gossip/enabled": False}
        monkeypatch.setattr(live, "session_values", lambda settings: deaf if settings.seeds else values(settings))
        for driver in drivers:
            await driver.open()
        monkeypatch.setattr(live, "session_values", values)
        tasks = [asyncio.create_task(driver.serve()) for driver in drivers]
        await until(lambda: all(agent.membership.session_watchdog.heard() for agent in agents))
        assert "s2" not in agents[0].membership.session_watchdog.heard() and "s1" not in agents[1].membership.session_watchdog.heard()
        everybody = set(config.members)
        await until(lambda: all({*agent.membership.session_watchdog.heard(), agent.name} == everybody for agent in agents), 60.0)
        assert drivers[0].counts["reopened"] + drivers[1].counts["reopened"] >= 1
        assert drivers[2].counts["reopened"] == 0
        for driver in drivers:
            driver.stop(0, "the test is over")
        await asyncio.gather(*tasks)

    asyncio.run(scene())


def test_link_faults_spoil_copy_and_delay_what_arrives() -> None:
    class Faults(LiveLink):
        def incoming(self, key: str, payload: bytes, now: float) -> list[tuple[float, bytes]]:
            return [(0.0, payload[:3]), (0.02, payload)]

    async def scene() -> None:
        left, right = Scribe("a"), Scribe("b")
        left.first = [Subscribe(keys.all_of(left.run, "command"))]
        async with Pair(left, right, link=Faults(1, "a")) as pair:
            await until(lambda: Alive("agent", "a", 1) in right.events)
            await until(lambda: bool(pair.drivers[1]._carry_out(command("b", 1))) or len(left.texts()) >= 2)
        assert Rejected("b", "format") in left.events

    asyncio.run(scene())


def test_a_port_in_use_is_one_clear_error() -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        endpoint = f"tcp/127.0.0.1:{holder.getsockname()[1]}"
        with pytest.raises(BadSetting, match=rf"network\.listen = {endpoint}: the port is in use") as caught:
            live.run(Scribe("a"), NetworkSettings(listen=(endpoint,)))
    assert "\n" not in str(caught.value)


CHILD = """
import sys
from protocol import live
from protocol.node import Node, Started
from protocol.settings import NetworkSettings
class Idle(Node):
    run, role, name, incarnation = "t", "agent", "a", 1
    def handle(self, event, now):
        print("started", flush=True)
        return []
    def deadline(self):
        return None
sys.exit(live.run(Idle(), NetworkSettings(), watch_stdin=True, on_line=lambda text: print("line", text, flush=True)))
"""


@pytest.fixture
def child() -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, "-c", CHILD], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        yield process


@pytest.mark.parametrize(("number", "code"), [(15, 143), (2, 130)])
def test_a_signal_ends_the_process_with_its_code(child: subprocess.Popen[str], number: int, code: int) -> None:
    child.send_signal(number)
    assert child.wait(20) == code


def test_lines_on_stdin_are_handed_on_and_its_end_stops_the_process(child: subprocess.Popen[str]) -> None:
    assert child.stdin is not None and child.stdout is not None
    child.stdin.write("hello\n")
    child.stdin.flush()
    assert child.stdout.readline() == "line hello\n"
    child.stdin.close()
    assert child.wait(20) == 143
