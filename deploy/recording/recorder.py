"""The recorder: everything that is heard goes into an MCAP file, the bytes as they were on the wire.

One channel per key expression, its schema attached; the resolved scenario stands at the head of the file. The log time of a message is the
world's time in ns when it was heard, so that a recording has one clock whatever the run's pace was. The publish time is the wall clock's
(Unix time, whole ms). A liveliness token is recorded under its key as the map {"alive": true or false}. A fault that does not show by
itself, such as a cut between agents, is a metadata record of its own.

What is heard reaches the file after 0.9 s at the latest, as a small chunk: a recorder that is killed loses less than a second. When 5 s
of the world have passed, one large chunk takes the place of the small ones: the file is 8 % smaller, its index a fifth as long.
"""

import json
import logging
import time
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import IO, Any, cast

import mcap.writer
import msgspec
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from deploy.installation import versions
from deploy.recording.crash_safe_file import GrowingFile
from deploy.scenario import Scenario, toml_text
from deploy.scoring.result import Fault
from deploy.scoring.scorer import witness_of
from protocol.codec import encode
from protocol.keys import all_of, message_key, token_key
from protocol.messages import KINDS
from protocol.node import Alive, Effect, Event, Gone, Node, Received, Rejected, Started, Subscribe, received
from protocol.observer_messages import Truth
from protocol.session_watchdog import ListenerWatchdog

FLUSH_SECONDS = 0.9
CHUNK_SECONDS = 5.0  # of the world; larger chunks save nothing more
CHUNK_BYTES = 1 << 20  # of payload; a flood fills memory up to here, in both writers: 4 MiB cost up to 24, and a file only 1 % smaller
WRITER_BYTES = 1 << 40  # the writers are never to close a chunk by themselves
MOST_CHANNELS = 60_000  # keys of one recording: an MCAP file numbers them with 16 bits
LEVEL = 6  # of zstd: the file is 3 % smaller than at the library's 3, at 4 ms more for a MB; higher levels save nothing more
PROFILE = "covey"
ABOUT, FAULT = "covey", "covey.fault"  # names of metadata records
TOKEN_SCHEMA = {"title": "Token", "type": "object", "properties": {"alive": {"type": "boolean"}}, "required": ["alive"]}

log = logging.getLogger(__name__)


class Compressor:
    """Replaces `zstandard` in the MCAP writer, which has no option for the level."""

    @staticmethod
    def compress(data: bytes) -> bytes:
        """One frame of zstd."""
        return zstandard.compress(data, level=LEVEL)


mcap.writer.zstandard = Compressor  # type: ignore[assignment]


class Tail:
    """A second writer, that gives what has been added as chunks for the tail of a file; it keeps neither index nor statistics."""

    def __init__(self) -> None:
        self._stream = BytesIO()
        self.writer = Writer(
            self._stream, WRITER_BYTES, CompressionType.ZSTD, index_types=IndexType.NONE, repeat_channels=False, use_statistics=False
        )
        self.writer.start(PROFILE)
        self.take()

    def take(self) -> bytes:
        """The chunk of what has been added since the last time."""
        self.writer.flush()
        data = self._stream.getvalue()
        self._stream.seek(0)
        self._stream.truncate()
        return data


class Recorder:
    """Writes events into one file. `see` never raises: a full disk must not end a run."""

    def __init__(self, path: Path, scenario: Scenario, wall: Callable[[], float] | None = time.time) -> None:
        """`wall` gives the publish times, s; None where time is virtual. Raises OSError when the file cannot be made."""
        self.path = path
        self.messages = 0  # recorded
        self.lost = 0  # messages after the recording has stopped on an error, and those under keys beyond `MOST_CHANNELS`
        self.stopped: str | None = None  # why it stopped by itself
        self._wall = wall
        self._closed = False
        self._now = 0  # the world's time, ns
        self._settled_now = 0
        self._pending = 0  # bytes of payload that have not been settled
        self._flushed_at = time.monotonic()
        self._run = scenario.run.name
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._file = GrowingFile(path)
        self._tail = Tail()
        self._writer = Writer(cast(IO[bytes], self._file), WRITER_BYTES, CompressionType.ZSTD)
        self._writer.start(PROFILE)
        about = {"run.toml": toml_text(scenario), "versions.json": json.dumps(versions()), "run": self._run}
        self._writer.add_metadata(ABOUT, about)
        self._file.settle()

    @property
    def file_bytes(self) -> int:
        """Size of the file so far."""
        return self._file.size

    def see(self, event: Event, now: float) -> None:
        """Record an event if it is a message, valid or not, or a token. What quarantine throws away is not recorded."""
        if isinstance(event, Received):
            for message, payload in zip(event.batch.messages, event.batch.payloads):
                if isinstance(message, Truth):
                    self._now = max(self._now, round(1e9 * message.time))
                self._record(message_key(self._run, message), payload)
        elif isinstance(event, Alive | Gone):
            key = token_key(self._run, event.role, event.name, event.incarnation)
            self._record(key, msgspec.msgpack.encode({"alive": isinstance(event, Alive)}))
        elif isinstance(event, Rejected) and event.reason != "quarantine":
            self._record(event.key, event.payload)

    def note_fault(self, fault: Fault) -> None:
        """Record a fault that was ordered."""
        if not self._closed:
            about = {"time": repr(fault.time), "verb": fault.verb, "text": fault.text, "who": fault.who, "sides": str(fault.sides)}
            self._writer.add_metadata(FAULT, about)
            self._guarded(self._settle)

    def flush(self, after: float = 0.0) -> None:
        """Let everything reach the file, if the last time is `after` s ago."""
        if not self._closed and time.monotonic() - self._flushed_at >= after:
            self._flushed_at = time.monotonic()
            self._guarded(self._extend)

    def close(self) -> None:
        """Write the index and close the file; one without a message is removed: it would be in the way of the next."""
        if not self._closed:
            self._guarded(self._finish)
            self._closed = True
            self._file.close()
        if not self.messages:
            self.path.unlink(missing_ok=True)

    def _extend(self) -> None:
        self._file.extend(self._tail.take())

    def _settle(self) -> None:
        """Close the chunk; it takes the place of the tail."""
        self._settled_now, self._pending, self._flushed_at = self._now, 0, time.monotonic()
        self._tail.take()
        self._writer.flush()
        self._file.settle()

    def _finish(self) -> None:
        self._writer.finish()
        self._file.settle()

    def _record(self, key: str, payload: bytes) -> None:
        if not self._closed and (self._now - self._settled_now >= 1e9 * CHUNK_SECONDS or self._pending >= CHUNK_BYTES):
            self._guarded(self._settle)  # by what was heard, not by the clock: a simulation's file is the same every time
        if self._closed:
            self.lost += self.stopped is not None
            return
        published = self._now if self._wall is None else 1_000_000 * round(1e3 * self._wall())
        if len(self._channels) >= MOST_CHANNELS and key not in self._channels:  # anybody can make up keys
            self.lost += 1
            return
        channel = self._channel(key)
        self.messages += 1
        self._pending += len(payload)
        for writer in (self._writer, self._tail.writer):
            writer.add_message(channel, self._now, payload, published)
        self.flush(FLUSH_SECONDS)

    def _channel(self, key: str) -> int:
        """The channel of a key; both writers number channels and schemas alike."""
        if key not in self._channels:
            parts = key.split("/")
            kind = parts[2] if len(parts) > 2 else ""
            known = kind in KINDS or kind == "alive"
            schema = self._schema(kind) if known else 0
            for writer in (self._writer, self._tail.writer):
                self._channels[key] = writer.register_channel(key, "msgpack" if known else "", schema)
        return self._channels[key]

    def _schema(self, kind: str) -> int:
        if kind not in self._schemas:
            schema = TOKEN_SCHEMA if kind == "alive" else message_schema(kind)
            for writer in (self._writer, self._tail.writer):
                self._schemas[kind] = writer.register_schema(f"covey.{schema['title']}", "jsonschema", json.dumps(schema).encode())
        return self._schemas[kind]

    def _guarded(self, write: Callable[[], None]) -> None:
        try:
            write()
        except OSError as error:
            self.stopped = error.strerror or str(error)
            self._closed = True
            self._file.close()
            log.warning("%s: %s; the recording ends here, the run goes on", self.path, self.stopped)


class RecorderNode(Node):
    """The recorder as a participant of its own: a process that may come, go and die without anybody's notice."""

    role = "recorder"
    incarnation = 1

    def __init__(self, recorder: Recorder, scenario: Scenario, name: str) -> None:
        self.run, self.name = scenario.run.name, name
        self._recorder = recorder
        self._witness = witness_of(scenario, "monitor", self.incarnation)
        self._watchdog = ListenerWatchdog(scenario.members, scenario.network.lease)
        self._due: float | None = None

    def deadline(self) -> float | None:
        """When the chunk must be written even without new messages."""
        return self._due

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do."""
        if isinstance(event, Started):
            self._due = now + FLUSH_SECONDS
            return [Subscribe(all_of(self.run, kind)) for kind in KINDS]
        self._recorder.see(event, now)
        for truth in self._witness.take(event, now) if self._witness is not None else ():
            self._recorder.see(received(truth, payloads=(encode(truth),)), now)
        if self._due is not None and now >= self._due:
            self._due = now + FLUSH_SECONDS
            self._recorder.flush(FLUSH_SECONDS)
        return self._watchdog.take(event, now)


def message_schema(kind: str) -> dict[str, Any]:
    """The JSON schema of one kind of message; bytes are msgpack bin and little-endian, row by row."""
    message = KINDS[kind]
    whole = msgspec.json.schema(message)
    schema: dict[str, Any] = {**whole["$defs"][message.__name__], "$defs": whole["$defs"]}
    schema["$comment"] = "msgpack map; arrays are little-endian bytes, see docs/reference/protocol.md"
    return schema
