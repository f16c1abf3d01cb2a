"""The live driver's passes over its inbox, and its timer, without a session: what the node awaits is handed over, no deadline is lost."""

import asyncio
import threading

import pytest

from protocol import codec, keys, live
from protocol.arrival_queue import Arrival
from protocol.link_faults import LinkCondition, LinkConditions, LiveLink, as_line
from protocol.message import Message
from protocol.messages import Hello
from protocol.node import NO_EFFECTS, Alive, Effect, Event, Gone, Started, Subscribe, Timer, Unsubscribe
from protocol.settings import NetworkSettings
from tests.protocol.test_live import Scribe, command, until

HELLO = Hello(sender="c", incarnation=1, software="test", sensor_class="")


class Patient(Scribe):
    """Awaits nine commands, and a single one once it has heard anything else."""

    coalesced_keys = "/command/"

    @property
    def wake_up_count(self) -> int:
        return 1 if HELLO in self.texts() or any(isinstance(event, Gone) for event in self.events) else 9


class Late:
    """Holds the messages of each sender back for so many s, 0.02 unless said; it notes when each one came."""

    def __init__(self, **delays: float) -> None:
        self.delays = delays
        self.came: list[float] = []

    def incoming(self, key: str, payload: bytes, now: float) -> list[tuple[float, bytes]]:
        self.came.append(now)
        return [(self.delays.get(key.rpartition("/")[2], 0.02), payload)]


def arrival(node: Scribe, message: Message) -> Arrival:
    return Arrival(keys.message_key(node.run, message), codec.encode(message), message.sender)


def test_what_a_link_delays_is_late_by_that_and_not_also_by_the_waiting_for_others() -> None:
    """Nine commands are awaited. One that waited for the others in the inbox would be late by the waiting and then by its link."""

    async def scene() -> None:
        node = Patient("a")
        driver = live.Driver(node, NetworkSettings(), Late())
        driver._handle_all([Started()])
        driver._arrive(arrival(node, command("b", 1)))
        await until(lambda: node.texts() == [command("b", 1)], 5.0)

    asyncio.run(scene())


class Clock:
    """The time of the running event loop. It stands still until a test sets it. A test that sets it says: the loop has computed so long."""

    def __init__(self) -> None:
        self.now = 100.0
        asyncio.get_running_loop().time = lambda: self.now  # type: ignore[method-assign]


def arrive_in_a_thread(driver: live.Driver, *arrivals: Arrival) -> None:
    """Let these arrive in a thread, as those of Zenoh do."""
    thread = threading.Thread(target=lambda: [driver._arrive(each) for each in arrivals])
    thread.start()
    thread.join()


async def one_pass() -> None:
    """Let the event loop do what it has been called for, and the timers that are due."""
    await asyncio.sleep(0)
    await asyncio.sleep(0)


def test_a_delay_counts_from_the_arrival_also_where_the_event_loop_computes_meanwhile() -> None:
    async def scene() -> None:
        node, link, clock = Scribe("a"), Late(b=0.5), Clock()
        driver = live.Driver(node, NetworkSettings(), link)
        arrive_in_a_thread(driver, arrival(node, command("b", 1)))
        clock.now = 100.25
        await one_pass()
        assert link.came == [100.0] and node.texts() == []
        clock.now = 100.49
        await one_pass()
        assert node.texts() == []
        clock.now = 100.5
        await one_pass()
        assert node.texts() == [command("b", 1)]
        arrive_in_a_thread(driver, arrival(node, command("b", 2)))
        clock.now = 102.0
        await asyncio.sleep(0)
        assert link.came == [100.0, 100.5] and node.texts() == [command("b", 1), command("b", 2)]

    asyncio.run(scene())


def test_what_was_due_while_the_event_loop_computed_comes_in_the_order_in_which_it_was_due() -> None:
    """So a link with one delay keeps the order of its messages, also where the first one has a timer and the second one comes meanwhile."""

    async def scene() -> None:
        node, clock = Scribe("a"), Clock()
        driver = live.Driver(node, NetworkSettings(), Late(b=0.5, c=0.2, d=0.0))
        arrive_in_a_thread(driver, arrival(node, command("b", 1)))
        await one_pass()
        clock.now = 100.125
        arrive_in_a_thread(driver, *[arrival(node, command(*each)) for each in (("b", 2), ("c", 1), ("c", 2), ("d", 1))])
        clock.now = 101.0
        driver._fire()  # earlier arrivals come before the timer of the node
        assert [(message.sender, message.tick) for message in node.texts()] == [("d", 1), ("c", 1), ("c", 2), ("b", 1), ("b", 2)]

    asyncio.run(scene())


def test_no_timer_comes_before_what_was_due_on_a_link_however_much_that_is() -> None:
    async def scene() -> None:
        node, clock = Scribe("a"), Clock()
        driver = live.Driver(node, NetworkSettings(), Late(b=0.5))
        arrive_in_a_thread(driver, *[arrival(node, command("b", tick)) for tick in range(3 * live.SLICE + 1)])
        await one_pass()
        clock.now = 100.5
        driver._fire()
        assert len(node.texts()) == 3 * live.SLICE + 1 and node.events[-1] == Timer()

    asyncio.run(scene())


def test_what_was_delayed_does_not_wait_for_others_that_the_node_awaits() -> None:
    """More than a slice is due, and twenty commands are awaited: the last six would else wait for more to come."""

    class Awaiting(Scribe):
        coalesced_keys, wake_up_count = "/command/", 20

    async def scene() -> None:
        node, clock = Awaiting("a"), Clock()
        driver = live.Driver(node, NetworkSettings(), Late(b=0.5))
        arrive_in_a_thread(driver, *[arrival(node, command("b", tick)) for tick in range(live.SLICE + 6)])
        await one_pass()
        clock.now = 101.0
        for _ in range(4):
            await one_pass()
        assert len(node.texts()) == live.SLICE + 6

    asyncio.run(scene())


def test_what_is_due_sooner_does_not_wait_for_what_came_before() -> None:
    async def scene() -> None:
        node, clock = Scribe("a"), Clock()
        driver = live.Driver(node, NetworkSettings(), Late(b=0.5, c=0.25))
        arrive_in_a_thread(driver, arrival(node, command("b", 1)))
        await one_pass()
        arrive_in_a_thread(driver, arrival(node, command("c", 1)))
        await one_pass()
        for now, tick in ((100.25, ["c"]), (100.5, ["c", "b"])):
            clock.now = now
            await one_pass()
            assert [message.sender for message in node.texts()] == tick

    asyncio.run(scene())


def test_a_token_waits_for_no_link_and_comes_after_the_messages_that_came_before_it() -> None:
    async def scene() -> None:
        node, clock = Scribe("a"), Clock()
        link = LiveLink(1, "a")
        link.on_line(as_line(LinkConditions(conditions={"c": LinkCondition(delay=0.5)})))
        driver = live.Driver(node, NetworkSettings(), link)
        token = Arrival(keys.token_key(node.run, "agent", "b", 1), token=True)
        arrive_in_a_thread(driver, arrival(node, command("b", 1)), arrival(node, command("c", 1)), token)
        clock.now = 100.25
        await one_pass()
        assert node.texts() == [command("b", 1)] and node.events[1:] == [Alive("agent", "b", 1)]

    asyncio.run(scene())


def test_a_death_that_a_new_session_reveals_and_that_ends_the_waiting_has_messages_handed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "SETTLE_SECONDS", 0.02)

    async def scene() -> None:
        node = Patient("a")
        driver = live.Driver(node, NetworkSettings())
        driver._handle_all([Started()])
        driver._drain()
        driver._tokens.see(keys.token_key(node.run, "agent", "ghost", 1), True)
        monkeypatch.setattr(driver, "open", lambda: asyncio.sleep(0))
        monkeypatch.setattr(driver, "_declare", lambda: driver._declared.append("token"))
        reopening = asyncio.create_task(driver._reopen())
        await until(lambda: driver.counts["reopened"] == 1)
        driver._arrive(arrival(node, command("b", 1)))
        await until(lambda: node.texts() == [command("b", 1)], 5.0)
        await reopening

    asyncio.run(scene())


def test_many_late_messages_ask_for_one_pass_over_what_waits() -> None:
    async def scene() -> None:
        node = Patient("a")
        driver = live.Driver(node, NetworkSettings())
        for tick in range(live.SLICE):
            driver._inbox.add(arrival(node, command("b", tick)))
        passes = []
        drain = driver._drain
        driver._drain = lambda: passes.append(drain())  # type: ignore[method-assign, func-returns-value]
        for _ in range(5):
            driver._receive([arrival(node, HELLO)])
        await asyncio.sleep(0.01)
        assert len(node.texts()) == 5 + live.SLICE
        assert len(passes) == 1

    asyncio.run(scene())


def test_a_timer_to_which_a_node_answers_nothing_comes_again() -> None:
    class Hesitant(Scribe):
        def handle(self, event: Event, now: float) -> list[Effect]:
            self.events.append(event)
            self.next = now + 0.01 if isinstance(event, Started) else self.next if self.events.count(Timer()) < 3 else None
            return NO_EFFECTS if isinstance(event, Timer) else []

    async def scene() -> None:
        node = Hesitant("a")
        live.Driver(node, NetworkSettings())._handle_all([Started()])
        await until(lambda: node.events == [Started(), Timer(), Timer(), Timer()], 5.0)

    asyncio.run(scene())


def test_a_deadline_that_is_taken_back_wakes_nobody() -> None:
    async def scene() -> None:
        node = Scribe("a")
        driver = live.Driver(node, NetworkSettings())
        for node.next in (driver._loop.time() + 0.01, None):
            driver._handle_all([Started()])
        await asyncio.sleep(0.05)
        assert Timer() not in node.events

    asyncio.run(scene())


def token(name: str, up: bool = True) -> Arrival:
    return Arrival(keys.token_key("t", "agent", name, 1), token=up)


def test_a_token_that_waits_in_the_inbox_while_the_node_unsubscribes_is_told_after_the_next_subscription() -> None:
    async def scene() -> None:
        node, expression = Scribe("a"), keys.tokens_of("t", "agent", "b")
        node.sees_all_tokens, node.run = False, "t"
        driver = live.Driver(node, NetworkSettings())
        driver._carry_out(Subscribe(expression))
        driver._inbox.add(token("b"))
        driver._carry_out(Unsubscribe(expression))
        driver._drain()
        assert node.events == []
        driver._carry_out(Subscribe(expression))
        driver._inbox.add(token("b"))
        driver._drain()
        assert node.events == [Alive("agent", "b", 1)]

    asyncio.run(scene())


def test_a_session_that_was_left_says_nothing_of_tokens_any_more() -> None:
    class Sample:
        key_expr, kind = keys.token_key("t", "agent", "b", 1), live.zenoh.SampleKind.PUT

    async def scene() -> None:
        node = Scribe("a")
        node.run = "t"
        driver = live.Driver(node, NetworkSettings())
        await driver.open()
        before = driver._token_callback()
        await driver._leave()
        before(Sample())  # type: ignore[arg-type]
        driver._drain_all()
        assert node.events == []
        driver._token_callback()(Sample())  # type: ignore[arg-type]
        driver._drain_all()
        assert node.events == [Alive("agent", "b", 1)]

    asyncio.run(scene())


def test_a_token_that_waits_in_the_inbox_while_the_session_is_opened_anew_must_be_seen_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "SETTLE_SECONDS", 0.02)

    async def scene() -> None:
        node = Scribe("a")
        node.run = "t"
        driver = live.Driver(node, NetworkSettings())

        async def close(_: object) -> None:
            driver._inbox.add(token("ghost"))

        monkeypatch.setattr(driver, "_close", close)
        monkeypatch.setattr(driver, "open", lambda: asyncio.sleep(0))
        monkeypatch.setattr(driver, "_declare", lambda: driver._declared.append("token"))
        await asyncio.wait_for(driver._reopen(), 5.0)
        assert node.events == [Alive("agent", "ghost", 1), Gone("agent", "ghost", 1)]

    asyncio.run(scene())
