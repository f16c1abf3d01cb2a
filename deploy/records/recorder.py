"""The recorder: everything that is heard goes into an MCAP file, the bytes as they were on the wire.

One channel per key expression, its schema attached; the resolved scenario stands at the head of the file. The log time of a message
is the world's time in ns when it was heard, so that a recording has one clock whatever the run's pace was; the publish time is the
wall clock's (Unix time). A liveliness token is recorded under its key as the map {"alive": true or false}.

A chunk is closed after 0.9 s at the latest and reaches the file in one piece: a recorder that is killed loses less than a second.
"""

import json
import logging
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, cast

import msgspec
from mcap.writer import CompressionType, Writer

from deploy.scenario import Scenario
from deploy.swarm.rundir import versions
from deploy.toml_text import toml_text
from protocol.keys import all_of, message_key, token_key
from protocol.messages import KINDS, Truth
from protocol.node import Alive, Effect, Event, Gone, Received, Rejected, Started, Subscribe

FLUSH_SECONDS = 0.9
CHUNK_BYTES = 1 << 22  # larger ones are smaller in all: every chunk has an index of its own
PROFILE = "covey"
TOKEN_SCHEMA = {"title": "Token", "type": "object", "properties": {"alive": {"type": "boolean"}}, "required": ["alive"]}

log = logging.getLogger(__name__)


class WholeFile:
    """A stream whose writes reach the file together at `flush`; when the disk is full the file ends with the last whole part."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        self._parts: list[bytes] = []
        self._staged = 0
        self.size = 0  # bytes in the file

    def write(self, data: bytes) -> int:
        """Keep the bytes for the next flush."""
        self._parts.append(bytes(data))
        self._staged += len(data)
        return len(data)

    def tell(self) -> int:
        """Where the next byte will stand."""
        return self.size + self._staged

    def flush(self) -> None:
        """Write what has been kept; raises OSError when it does not fit, the file being as before."""
        data = memoryview(b"".join(self._parts))
        self._parts, self._staged = [], 0
        written = 0
        try:
            while written < len(data):
                written += self._file.write(data[written:])
        except OSError:
            os.ftruncate(self._file.fileno(), self.size)
            raise
        self.size += written

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Recorder:
    """Writes what it is shown into one file; `see` never raises, for a full disk must not end a run."""

    def __init__(self, path: Path, scenario: Scenario, wall: Callable[[], float] | None = time.time) -> None:
        """`wall` gives the publish times, s; None where time is virtual. Raises OSError when the file cannot be made."""
        self.path = path
        self.messages = 0  # recorded
        self.lost = 0  # after the recording has stopped on an error
        self.stopped: str | None = None  # why it stopped by itself
        self._wall = wall
        self._closed = False
        self._now = 0  # the world's time, ns
        self._flushed_at = time.monotonic()
        self._run = scenario.run.name
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._file = WholeFile(path)
        self._writer = Writer(cast(IO[bytes], self._file), CHUNK_BYTES, CompressionType.ZSTD)
        self._writer.start(PROFILE)
        self._writer.add_metadata(
            "covey", {"run.toml": toml_text(msgspec.to_builtins(scenario)), "versions.json": json.dumps(versions()), "run": self._run}
        )
        self._writer.flush()

    @property
    def file_bytes(self) -> int:
        """Size of the file so far."""
        return self._file.size

    def see(self, event: Event, now: float) -> None:
        """Record an event if it is a message, valid or not, or a token. What quarantine throws away is not recorded."""
        if isinstance(event, Received):
            if isinstance(event.message, Truth):
                self._now = max(self._now, round(1e9 * event.message.time))
            self._record(message_key(self._run, event.message), event.payload)
        elif isinstance(event, Alive | Gone):
            key = token_key(self._run, event.role, event.name, event.incarnation)
            self._record(key, msgspec.msgpack.encode({"alive": isinstance(event, Alive)}))
        elif isinstance(event, Rejected) and event.reason != "quarantine":
            self._record(event.key, event.payload)

    def flush(self, after: float = 0.0) -> None:
        """Close the chunk and write it, if the last one is `after` s old."""
        if not self._closed and time.monotonic() - self._flushed_at >= after:
            self._flushed_at = time.monotonic()
            self._guarded(self._writer.flush)

    def close(self) -> None:
        """Write the index and close the file."""
        if not self._closed:
            self._guarded(self._finish)
            self._closed = True
            self._file.close()

    def _finish(self) -> None:
        self._writer.finish()
        self._file.flush()

    def _record(self, key: str, payload: bytes) -> None:
        if self._closed:
            self.lost += self.stopped is not None
            return
        published = self._now if self._wall is None else round(1e9 * self._wall())
        self.messages += 1
        self._writer.add_message(self._channel(key), self._now, payload, published)
        self.flush(FLUSH_SECONDS)

    def _channel(self, key: str) -> int:
        if key not in self._channels:
            parts = key.split("/")
            kind = parts[2] if len(parts) > 2 else ""
            known = kind in KINDS or kind == "alive"
            schema = self._schema(kind) if known else 0
            self._channels[key] = self._writer.register_channel(key, "msgpack" if known else "", schema)
        return self._channels[key]

    def _schema(self, kind: str) -> int:
        if kind not in self._schemas:
            schema = TOKEN_SCHEMA if kind == "alive" else message_schema(kind)
            self._schemas[kind] = self._writer.register_schema(f"covey.{schema['title']}", "jsonschema", json.dumps(schema).encode())
        return self._schemas[kind]

    def _guarded(self, write: Callable[[], None]) -> None:
        try:
            write()
        except OSError as error:
            self.stopped = error.strerror or str(error)
            self._closed = True
            self._file.close()
            log.warning("%s: %s; the recording ends here, the run goes on", self.path, self.stopped)


class RecorderNode:
    """The recorder as a participant of its own: a process that may come, go and die without anybody's notice."""

    role = "recorder"
    incarnation = 1

    def __init__(self, recorder: Recorder, run: str, name: str) -> None:
        self.run, self.name = run, name
        self._recorder = recorder
        self._due: float | None = None

    def deadline(self) -> float | None:
        """When the chunk must be written even if nobody speaks."""
        return self._due

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do."""
        if isinstance(event, Started):
            self._due = now + FLUSH_SECONDS
            return [Subscribe(all_of(self.run, kind)) for kind in KINDS]
        self._recorder.see(event, now)
        if self._due is not None and now >= self._due:
            self._due = now + FLUSH_SECONDS
            self._recorder.flush(FLUSH_SECONDS)
        return []


def message_schema(kind: str) -> dict[str, Any]:
    """The JSON schema of one kind of message; bytes are msgpack bin and little-endian, row by row."""
    message = KINDS[kind]
    whole = msgspec.json.schema(message)
    schema: dict[str, Any] = {**whole["$defs"][message.__name__], "$defs": whole["$defs"]}
    schema["$comment"] = "msgpack map; arrays are little-endian bytes, see docs/protocol.md"
    return schema
