"""The control socket of a running swarm: JSON lines over a Unix socket, one answer per request.

{"verb": "kill", "who": "30%"}  ->  {"ok": "killed s2, s7"}  or  {"error": "one line"}
{"verb": "status"}              ->  {"ok": "", "data": {...}}
{"verb": "faults"}              ->  {"ok": "", "data": [[12.5, "partition", "cut off s5", "", 2], ...]}

A fault is its time in the world s, its verb, a text, the affected names and the sides that cuts make (deploy.scoring.result.Fault).
"""

import asyncio
import json
import logging
import os
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting
from protocol.whole_file import write_whole

Answer = dict[str, Any]
MOST_LINE = 1 << 20
MOST_ANSWER = 1 << 22
ANSWER_SECONDS = 20.0
CLIENT_SECONDS = 30.0  # that a command waits for an answer

log = logging.getLogger(__name__)


class ControlServer:
    """Listens on the control socket of a run and hands requests to `answer`."""

    def __init__(self, directory: RunDirectory, answer: Callable[[dict[str, Any]], Awaitable[Answer]]) -> None:
        self._directory = directory
        self._answer = answer
        self._server: asyncio.Server | None = None
        self._path: Path | None = None

    async def open(self) -> None:
        """Start to listen, and say in control.json where; raises BadSetting where no socket can be made."""
        self._path = self._directory.socket_path()
        self._path.unlink(missing_ok=True)
        try:
            self._server = await asyncio.start_unix_server(self._serve, str(self._path), limit=MOST_LINE)
        except OSError as error:  # as of a full disk, which names no file
            raise BadSetting(f"TMPDIR = {self._path.parent.parent}: the run's socket cannot be made there: {error.strerror}") from None
        write_whole(self._directory.control, json.dumps({"socket": str(self._path), "pid": os.getpid()}).encode() + b"\n")

    async def close(self) -> None:
        """Stop to listen and remove the socket."""
        if self._server is not None:
            self._server.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)
        self._directory.control.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                writer.write(json.dumps(await self._one(line)).encode() + b"\n")
                await writer.drain()
        except (ConnectionError, ValueError):
            pass  # a client that left or wrote an endless line
        except asyncio.CancelledError:
            pass  # the run ends; were it raised again, asyncio before 3.12 would log an error
        finally:
            writer.close()

    async def _one(self, line: bytes) -> Answer:
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise BadSetting("a request is a JSON object with a verb")
            return await self._answer(request)
        except json.JSONDecodeError:
            return {"error": "a request is one line of JSON"}
        except BadSetting as error:
            return {"error": str(error)}
        except Exception as error:
            log.exception("a request could not be carried out")
            return {"error": f"the supervisor failed at it, see its log: {type(error).__name__}: {error}"}


class ControlClient:
    """Speaks to the supervisor of a running run. Each request has its own connection: a late answer spoils no later one.

    It blocks, in threads with an event loop of somebody else's too, such as one that drives a browser; `ask` can be cancelled.
    """

    def __init__(self, directory: RunDirectory) -> None:
        try:
            self._socket = json.loads(directory.control.read_text(encoding="utf-8"))["socket"]
        except (OSError, ValueError, KeyError):
            raise BadSetting(f"--run {directory.name}: the run is starting or ending; try again in a second") from None

    def ask(self, verb: str, who: str = "", value: float | None = None, options: dict[str, Any] | None = None) -> Answer:
        """The answer to a request; raises BadSetting with the supervisor's complaint, or when it has gone."""
        request = {"verb": verb, "who": who, "value": value, "options": options or {}}
        try:
            with socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(CLIENT_SECONDS)
                connection.connect(self._socket)
                connection.sendall(json.dumps(request).encode() + b"\n")
                with connection.makefile("rb") as answers:
                    line = answers.readline()
        except TimeoutError:
            raise BadSetting(f"the supervisor has not answered for {CLIENT_SECONDS:.0f} s; the run may still go on") from None
        except PermissionError as error:
            raise BadSetting(f"{self._socket}: {error.strerror}: the run is that of another user") from None
        except OSError:
            line = b""
        if not line.endswith(b"\n"):
            raise BadSetting("the run has ended")
        answer = json.loads(line)
        if "error" in answer:
            raise BadSetting(answer["error"])
        return answer


async def ask(directory: RunDirectory, verb: str, who: str = "") -> Answer:
    """The supervisor's answer to one request, in an event loop; raises BadSetting with its complaint, or without an answer."""
    try:
        where = json.loads(directory.control.read_text(encoding="utf-8"))["socket"]
        async with asyncio.timeout(ANSWER_SECONDS):
            answer = await _one_answer(where, json.dumps({"verb": verb, "who": who}).encode() + b"\n")
    except (OSError, ValueError, KeyError, TimeoutError):
        raise BadSetting("the supervisor does not answer: the run is starting or has ended") from None
    if "error" in answer:
        raise BadSetting(answer["error"])
    return answer


async def _one_answer(where: str, request: bytes) -> Answer:
    reader, writer = await asyncio.open_unix_connection(where, limit=MOST_ANSWER)
    try:
        writer.write(request)
        answer: Answer = json.loads(await reader.readline())
        return answer
    finally:
        writer.close()
