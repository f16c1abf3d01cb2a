"""Reading a recording: its messages in order of arrival, and its scenario.

The index at the end of the file is used when it is there. When the recorder was killed, or is still writing, it is not, and the file is
read from its beginning as far as it is whole.
"""

import os
import struct
import tomllib
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import msgspec
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from deploy.recording.recorder import ABOUT, FAULT
from deploy.scenario import Scenario
from deploy.scoring.result import Fault
from deploy.storage.kept_runs import find_run, recordings_in
from deploy.storage.run_directory import runs_folder
from protocol import codec
from protocol.fields import Malformed
from protocol.keys import parse_message_key, parse_token
from protocol.node import Alive, Event, Gone, Rejected, received
from protocol.settings import BadSetting, convert

NAME = "recording.mcap"
NO_END = "has no end: its recorder was killed or still writes"
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
FOOTER_BYTES = 37  # at the end of a whole file: the last record and the magic bytes
BROKEN = (McapError, ValueError, struct.error, EOFError, IndexError, KeyError, MemoryError, OverflowError, zstandard.ZstdError)


class RecordedEntry(NamedTuple):
    """One thing that was heard."""

    key: str
    time: float  # the world's, s
    payload: bytes
    published: int  # Unix time of the recorder, ns


class Span(NamedTuple):
    """A chunk: where it begins in the file, and the world's time at its ends, s."""

    offset: int
    start: float
    end: float


class Recording:
    """One recording; raises BadSetting when the file is none."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.spans: list[Span] = []
        self.faults: list[Fault] = []
        self.is_whole = False  # closed as it should be, with an index
        self._topics: dict[int, str] = {}
        try:
            with path.open("rb") as file:
                metadata = self._read_index(file) or self._walk(file)
        except OSError as error:
            raise BadSetting(f"{path}: {error.strerror}") from None
        if metadata is None:
            raise BadSetting(f"{path}: no recording of Covey: should be an MCAP file that --record has written")
        self.run = metadata.get("run", "")
        try:
            self.versions: dict[str, object] = msgspec.json.decode(metadata.get("versions.json", "{}"))
            self.scenario = _scenario(path, metadata["run.toml"])
        except (msgspec.MsgspecError, tomllib.TOMLDecodeError, KeyError) as error:
            raise BadSetting(f"{path}: what it says of its run is damaged: {error}") from None

    @property
    def seconds(self) -> float:
        """The world's time at the end, s."""
        return self.spans[-1].end if self.spans else 0.0

    @property
    def wall_seconds(self) -> float | None:
        """How long the run took from its first Truth on, s of the wall clock; None of a simulation, whose publish times are the world's.

        Chunks that a recorder has replaced since they were found count for nothing.
        """
        first = next(filter(_is_truth, self.entries()), None)
        tails = (list(self.entries(number, number + 1)) for number in reversed(range(len(self.spans))))
        last = next((tail[-1] for tail in tails if tail), None)
        if first is None or last is None:
            return 0.0
        return None if last.published == round(1e9 * last.time) else (last.published - first.published) / 1e9

    def entries(self, first: int = 0, last: int | None = None) -> Iterator[RecordedEntry]:
        """What the chunks number `first` to `last` (excluded) hold, in order; raises BadSetting when one is damaged.

        In a file without an index they end at the first that is not whole: a recorder that still writes puts one large chunk in the
        place of the small ones of its tail.
        """
        with self.path.open("rb") as file:
            for span in self.spans[first:last]:
                file.seek(span.offset)
                try:
                    found = self._entries_of(_read_chunk(file))
                except BROKEN as error:
                    if not self.is_whole:
                        return
                    raise BadSetting(f"{self.path}: the chunk at byte {span.offset} is damaged: {error}") from None
                yield from found

    def played(self, first: int = 0) -> Iterator[RecordedEntry]:
        """The entries from chunk `first` on; of a run that was ended early without the tokens that its agents lost by that.

        All processes of such a run are ended at once, and their tokens go in any order. So an agent that leaves after the last Truth has
        not died, if the world or a body leaves there as well. Of a run that went to its end the order tells (`ends_run`).
        """
        run = self.scenario.run
        if self.seconds > (run.ticks - 1.5) * run.dt:
            yield from self.entries(first)
            return
        held: list[RecordedEntry] = []  # from the first token on that has gone after a Truth
        for entry in self.entries(first):
            if held and _is_truth(entry):
                yield from held
                held.clear()
            if held or _role_of_leaver(entry):
                held.append(entry)
            else:
                yield entry
        was_ended = any(_role_of_leaver(entry) in ("world", "body") for entry in held)
        yield from (entry for entry in held if not was_ended or _role_of_leaver(entry) != "agent")

    def _entries_of(self, chunk: Chunk) -> list[RecordedEntry]:
        found = []
        for record in breakup_chunk(chunk, validate_crc=True):
            if isinstance(record, Message):
                found.append(RecordedEntry(self._topics[record.channel_id], record.log_time / 1e9, record.data, record.publish_time))
            elif isinstance(record, Channel):
                self._topics[record.id] = record.topic
        return found

    def _read_index(self, file: IO[bytes]) -> dict[str, str] | None:
        """The metadata of a whole file, its spans and channels; None when there is no index."""
        if file.seek(0, os.SEEK_END) < FOOTER_BYTES:
            return None
        file.seek(0)
        try:
            reader = make_reader(file)
            summary = reader.get_summary()
            metadata = self._note_metadata(reader.iter_metadata())
        except BROKEN:
            return None
        if summary is None or metadata is None:
            return None
        self._topics = {number: channel.topic for number, channel in summary.channels.items()}
        chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
        self.spans = [Span(chunk.chunk_start_offset, chunk.message_start_time / 1e9, chunk.message_end_time / 1e9) for chunk in chunks]
        self.is_whole = True
        return metadata

    def _walk(self, file: IO[bytes]) -> dict[str, str] | None:
        """The same by reading from the beginning as far as the file is whole; None for a file of another program."""
        metadata = None
        file.seek(0)
        try:
            records = StreamReader(file, emit_chunks=True).records
            while True:
                offset = file.tell() or 8  # the magic bytes have not been read before the first record
                record = next(records)
                if isinstance(record, Metadata):
                    metadata = self._note_metadata([record]) or metadata
                elif isinstance(record, Chunk):
                    self._note_channels(record)
                    self.spans.append(Span(offset, record.message_start_time / 1e9, record.message_end_time / 1e9))
        except (StopIteration, *BROKEN):
            return metadata

    def _note_metadata(self, records: Iterable[Metadata]) -> dict[str, str] | None:
        """Keep the faults; what the recording says about itself, if that is among the records."""
        about = None
        for record in records:
            if record.name == ABOUT:
                about = record.metadata
            elif record.name == FAULT:
                found = record.metadata
                who, sides = found.get("who", ""), int(found.get("sides", 1))
                self.faults.append(Fault(float(found["time"]), found["verb"], found["text"], who, sides))
        return about

    def _note_channels(self, chunk: Chunk) -> None:
        self._topics |= {record.id: record.topic for record in breakup_chunk(chunk, validate_crc=True) if isinstance(record, Channel)}


def _read_chunk(file: IO[bytes]) -> Chunk:
    """The chunk that begins here; raises one of BROKEN when there is none."""
    opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise ValueError(f"no chunk begins here: opcode {opcode}")
    return Chunk.read(ReadDataStream(BytesIO(file.read(length))))


def _scenario(path: Path, text: str) -> Scenario:
    return convert(tomllib.loads(text), Scenario, str(path))


def event_of(entry: RecordedEntry) -> Event:
    """The event of a recorded entry."""
    token = parse_token(entry.key)
    if token is not None:
        alive = bool(msgspec.msgpack.decode(entry.payload).get("alive"))
        return (Alive if alive else Gone)(token.role, token.name, token.incarnation)
    try:
        return received(codec.decode(entry.key, entry.payload), payloads=[entry.payload])
    except Malformed as error:
        return Rejected(entry.key.rpartition("/")[2], error.reason, entry.key, entry.payload)


def _role_of_leaver(entry: RecordedEntry) -> str | None:
    """The role of the process whose token goes with this entry, if it is one that goes."""
    token = parse_token(entry.key)
    return token.role if token is not None and isinstance(event_of(entry), Gone) else None


def _is_truth(entry: RecordedEntry) -> bool:
    parts = parse_message_key(entry.key)
    return parts is not None and parts.kind == "truth"


def find_recording(name: str) -> Path:
    """The recording that is meant: of a run by its name, which wins over a file of that name; a file; or a run directory.

    `latest` is the newest run. Raises BadSetting when there is no recording.
    """
    path, run = Path(name), find_run(name)
    if run is None and path.is_file():
        return path
    folder = run.path if run is not None else path
    if not folder.is_dir():
        raise BadSetting(f"{name}: no such file, and no run of this name in {runs_folder()}; `covey runs` lists them")
    found = recordings_in(folder)
    if not found:
        raise BadSetting(f"{folder.resolve()}: no recording in it; run with --record to have one")
    return found[-1]
