"""The live driver hands on all that it is sent, in order, however it comes: single words, bursts, and beside others that may wait."""

import asyncio

import pytest

from protocol import keys
from protocol.messages import Command
from protocol.node import Alive, Subscribe, messages_of
from tests.protocol.test_live import Pair, Scribe, command, until

pytestmark = pytest.mark.live
BURSTS = (1, 2, 3, 40, 1, 150, 600)  # more than a slice of the inbox


@pytest.mark.parametrize("coalesced_keys", ["", "/command/"])
def test_everything_that_is_said_is_heard_once_and_in_order(coalesced_keys: str) -> None:
    async def scene() -> list[int]:
        left = Scribe("a")
        left.coalesced_keys = coalesced_keys
        left.first = [Subscribe(keys.all_of(left.run, "command"))]
        right = Scribe("b")
        async with Pair(left, right, most_per_second=5000) as pair:
            await until(lambda: Alive("agent", "b", 1) in left.events and Alive("agent", "a", 1) in right.events)
            tick = 0
            while not left.texts():  # until the subscription has arrived
                pair.drivers[1]._carry_out(command("b", tick))
                tick += 1
                await asyncio.sleep(0.01)
            for burst in BURSTS:
                for _ in range(burst):
                    pair.drivers[1]._carry_out(command("b", tick))
                    tick += 1
                await asyncio.sleep(0.02)
            await until(lambda: any(message.tick == tick - 1 for message in left.texts()), 10.0)  # type: ignore[attr-defined]
            sent, received = pair.drivers[1].counts["sent"], pair.drivers[0].counts["received"]
        ticks = [message.tick for event in left.events for message in messages_of(event) if isinstance(message, Command)]
        assert received == len(ticks) <= sent
        assert ticks == list(range(ticks[0], tick))
        return ticks

    assert len(asyncio.run(scene())) >= sum(BURSTS)
