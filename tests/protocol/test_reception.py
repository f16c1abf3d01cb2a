"""What has arrived becomes events in its order; senders of garbage are shut out, within one batch as well, and nobody else."""

from collections import Counter

from protocol import codec
from protocol.arrival_queue import Arrival
from protocol.keys import Token, message_key, token_key
from protocol.liveliness_tokens import Tokens
from protocol.messages import Command
from protocol.node import Alive, Event, Gone, Received, Rejected, messages_of
from protocol.reception import Reception

OWN = Token("t", "agent", "me", 1)


def arrival(tick: int, source: str = "z1", sender: str = "s1") -> Arrival:
    message = Command(sender=sender, incarnation=1, tick=tick, velocity=(1.0, 2.0), turn_rate=0.5)
    return Arrival(message_key("t", message), codec.encode(message), source)


def garbage(source: str = "z1", key: str = "covey/t/command/s1") -> Arrival:
    return Arrival(key, b"\xc1", source)


def reception() -> tuple[Reception, Counter[str]]:
    counts: Counter[str] = Counter()
    return Reception(Tokens(OWN, ["covey/**"]), counts), counts


def kinds(events: list[Event]) -> list[str]:
    return [f"rejected {e.reason}" if isinstance(e, Rejected) else type(e).__name__ for e in events]


def test_messages_tokens_and_garbage_become_events_in_the_order_of_arrival() -> None:
    reader, counts = reception()
    token = token_key("t", "agent", "s9", 4)
    batch = [
        arrival(1),
        Arrival(token, token=True),
        garbage(),
        Arrival(token, token=True),
        arrival(2),
        Arrival(token_key(*OWN), token=True),
        Arrival(token, token=False),
    ]
    events = list(reader.events(batch, 0.0))
    assert kinds(events) == ["Received", "Alive", "rejected format", "Received", "Gone"]
    assert events[1] == Alive("agent", "s9", 4) and events[4] == Gone("agent", "s9", 4)
    first, second = events[0], events[3]
    assert isinstance(first, Received) and first.batch.kind is Command
    assert [message.tick for message in first.batch.messages] == [1] and first.batch.payloads == (batch[0].payload,)
    assert isinstance(second, Received) and second.batch.payloads == (batch[4].payload,)
    assert counts == {"received": 2, "rejected": 1}


def test_who_is_shut_out_is_not_read_and_the_owner_of_the_key_is() -> None:
    reader, counts = reception()
    assert set(kinds(list(reader.events([garbage("bad")] * 30, 0.0)))) == {"rejected format", "rejected quarantine"}
    assert counts == {"rejected": 20, "quarantined": 10}
    assert kinds(list(reader.events([arrival(1, "bad"), arrival(1, "good"), arrival(2, "bad")], 5.0))) == [
        "rejected quarantine",
        "Received",
        "rejected quarantine",
    ]
    assert kinds(list(reader.events([arrival(3, "bad")], 11.0))) == ["Received"]


def test_who_does_not_say_its_session_is_known_by_its_key() -> None:
    reader, _ = reception()
    list(reader.events([garbage("")] * 20, 0.0))
    assert kinds(list(reader.events([arrival(1, ""), arrival(1, "", sender="s2")], 1.0))) == ["rejected quarantine", "Received"]


def test_consecutive_messages_of_one_kind_are_one_batch() -> None:
    reader, _ = reception()
    token = Arrival(token_key("t", "agent", "s9", 4), token=True)
    arrivals = [arrival(1), arrival(2), token, arrival(3), garbage(), arrival(4), arrival(5)]
    events = list(reader.events(arrivals, 0.0))
    assert kinds(events) == ["Received", "Alive", "Received", "rejected format", "Received"]
    assert [[message.tick for message in messages_of(event)] for event in events] == [[1, 2], [], [3], [], [4, 5]]
    assert list(reader.events([], 0.0)) == []
