"""The live driver's passes over its inbox, and its timer, without a session: what the node awaits is handed over, no deadline is lost."""

import asyncio

import pytest

from protocol import codec, keys, live
from protocol.inbox import Arrival
from protocol.message import Message
from protocol.messages import Hello
from protocol.node import NO_EFFECTS, Alive, Effect, Event, Gone, Started, Subscribe, Timer, Unsubscribe
from protocol.settings import NetworkSettings
from tests.protocol.test_live import Scribe, command, until

HELLO = Hello(sender="c", incarnation=1, software="test", sensor_class="", max_speed=1.0, max_turn_rate=1.0)


class Patient(Scribe):
    """Awaits nine commands, and a single one once it has heard anything else."""

    coalesced_keys = "/command/"

    @property
    def wake_up_count(self) -> int:
        return 1 if HELLO in self.texts() or any(isinstance(event, Gone) for event in self.events) else 9


class Late:
    """Holds every message back for 0.02 s."""

    def incoming(self, key: str, payload: bytes, now: float) -> list[tuple[float, bytes]]:
        return [(0.02, payload)]


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
