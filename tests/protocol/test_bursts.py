"""What many say at the same moment reaches who listens to all of them, though it meets on one link; what one says too often does not."""

import asyncio

import pytest

from protocol import live
from protocol.endpoints import free_port
from protocol.keys import all_of
from protocol.messages import Hello
from protocol.node import Alive, Effect, Event, Received, Started, Subscribe
from protocol.observer_messages import Estimate
from protocol.settings import NetworkSettings
from tests.protocol.test_live import Pair, Scribe, command, until

pytestmark = pytest.mark.live
MOUTHS, BYTES = 24, 16 * 1024


class Ear(Scribe):
    """Asks everybody to speak, again and again until somebody has."""

    def handle(self, event: Event, now: float) -> list[Effect]:
        super().handle(event, now)
        self.next = None if self.texts() else now + 0.2
        asked: list[Effect] = [Hello(sender=self.name, incarnation=1, software="test", sensor_class="")]
        return [Subscribe(all_of(self.run, "estimate"))] if isinstance(event, Started) else [] if self.texts() else asked


class Mouth(Scribe):
    """Says 16 kB when it is asked for the first time."""

    def handle(self, event: Event, now: float) -> list[Effect]:
        first = isinstance(event, Received) and not self.texts()
        super().handle(event, now)
        if isinstance(event, Started):
            return [Subscribe(all_of(self.run, "hello"))]
        targets = bytes(BYTES)
        said = Estimate(
            sender=self.name,
            incarnation=1,
            tick=0,
            pose=(0.0, 0.0, 0.0),
            cod=(0.0, 0.0),
            power_radius=0.0,
            unused=0.0,
            targets_bytes=targets,
        )
        return [said] if first else []


def test_what_all_say_at_once_behind_a_router_is_heard_in_full() -> None:
    asyncio.run(talk())


async def talk() -> None:
    at = f"tcp/127.0.0.1:{free_port()}"
    ear, hub = Ear("ear"), Scribe("hub")
    mouths = [Mouth(f"m{number}") for number in range(MOUTHS)]
    for node in (hub, *mouths):
        node.run = ear.run
    router, clients = NetworkSettings(listen=(at,), mode="router"), NetworkSettings(seeds=(at,), mode="client")
    drivers = [live.Driver(hub, router)]
    tasks = [asyncio.create_task(drivers[0].serve())]
    try:
        await until(lambda: bool(hub.events))
        for node in (*mouths, ear):
            drivers.append(live.Driver(node, clients))
            tasks.append(asyncio.create_task(drivers[-1].serve()))
            await until(lambda node=node: bool(node.events))  # type: ignore[misc]
        await until(lambda: all(mouth.texts() for mouth in mouths))
        await until(lambda: len(ear.texts()) >= MOUTHS, 5.0)
    finally:
        for driver in drivers:
            driver.stop(0, "the test is over")
        await asyncio.gather(*tasks, return_exceptions=True)
    assert {message.sender for message in ear.texts()} == {mouth.name for mouth in mouths}


def test_what_exceeds_the_rate_of_the_settings_is_counted_and_not_read() -> None:
    asyncio.run(chatter())


async def chatter() -> None:
    left, right = Scribe("a"), Scribe("b")
    left.first = [Subscribe(all_of(left.run, "command"))]
    async with Pair(left, right, most_per_second=10) as pair:
        await until(lambda: Alive("agent", "b", 1) in left.events)
        ear, mouth = pair.drivers
        await until(lambda: bool(mouth._carry_out(command("b", 0))) or bool(left.texts()))
        for tick in range(1, 200):
            mouth._carry_out(command("b", tick))
        await until(lambda: len(left.texts()) + ear.counts["flooded"] >= 200)
        assert 10 <= len(left.texts()) <= 100 and ear.counts["flooded"] >= 100
