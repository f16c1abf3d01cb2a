"""The shared part of the agent and the world process: arguments, logs as JSON lines, the end with the parent, exit codes."""

import argparse
import contextlib
import ctypes
import json
import logging
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NoReturn, TypeVar

import msgspec

from protocol import live
from protocol.link_faults import LiveLink
from protocol.node import Node
from protocol.settings import BadSetting, CommonSettings, NetworkSettings, load

PR_SET_PDEATHSIG = 1  # linux/prctl.h
STANDARD_FIELDS = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}

Config = TypeVar("Config", bound=CommonSettings)
Role = TypeVar("Role", bound=Node)


class JsonLines(logging.Formatter):
    """One JSON object per record: time, level, run, agent, message, and the fields of `extra` (tick, counts)."""

    def __init__(self, run: str, name: str) -> None:
        super().__init__()
        self._run = run
        self._name = name

    def format(self, record: logging.LogRecord) -> str:
        """The record as one line."""
        line = {"time": round(record.created, 3), "level": record.levelname.lower(), "run": self._run, "agent": self._name}
        line["message"] = record.getMessage()
        line.update({field: value for field, value in vars(record).items() if field not in STANDARD_FIELDS})
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def log_json_lines(run: str, name: str) -> None:
    """Send all logging of this process to stderr as JSON lines; raises BadSetting for a COVEY_LOG that is no level."""
    level = os.environ.get("COVEY_LOG") or "INFO"
    if level.upper() not in logging.getLevelNamesMapping():
        raise BadSetting(f"COVEY_LOG {level}: should be DEBUG, INFO or WARNING")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines(run, name))
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    logging.raiseExceptions = False  # a log that cannot be written ends no process


def die_with_parent() -> None:
    """Ask the kernel to kill this process when its parent dies; leave at once if the parent is already gone.

    The signal is SIGKILL, which also ends a paused process. The end of stdin shows a parent that died before the call.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    poll = select.poll()
    poll.register(0, select.POLLIN)
    if any(event & select.POLLHUP and not event & select.POLLIN for _, event in poll.poll(0)):
        leave(143)


def use_batch_scheduling() -> None:
    """Ask the kernel not to preempt a running process when a message wakes this one.

    In lockstep every agent waits for every other, and a round that is interrupted finds its data gone from the caches.
    """
    if hasattr(os, "SCHED_BATCH"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def leave(code: int) -> NoReturn:
    """End the process now: a Zenoh session that failed to close could block the end of the interpreter for ever."""
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    os._exit(code)


def arguments(role: str, words: list[str] | None = None) -> argparse.Namespace:
    """The parsed command line of `python -m agents` or `python -m world`."""
    parser = argparse.ArgumentParser(prog=f"python -m {role}", description=f"One {role} process of a Covey run.")
    parser.add_argument("--name", required=role == "agents", default="world", help="name of this process, unique in the run")
    parser.add_argument(
        "--config",
        required=True,
        type=Path,
        metavar="FILE",
        help="agents.toml of a run directory; the world: run.toml",
    )
    if role == "agents":
        parser.add_argument("--sensor", default="", metavar="CLASS", help="of the own sensor; default: as the roster of FILE says")
    parser.add_argument("--incarnation", type=int, default=None, help="grows with every restart; default: the clock in ms")
    parser.add_argument("--listen", action="append", metavar="ENDPOINT", help="listen here instead of network.listen")
    parser.add_argument("--seed-endpoint", action="append", metavar="ENDPOINT", help="dial this instead of network.seeds")
    parser.add_argument("--supervised", action="store_true", help="end with the parent: when it dies or when stdin ends")
    return parser.parse_args(words)


def network_of(config: CommonSettings, options: argparse.Namespace) -> NetworkSettings:
    """The network settings, overridden by the endpoints of the command line; by default the members are admitted."""
    listen = tuple(options.listen) if options.listen else config.network.listen
    seeds = tuple(options.seed_endpoint) if options.seed_endpoint else config.network.seeds
    return msgspec.structs.replace(config.network, listen=listen, seeds=seeds, admit=config.network.admit or tuple(config.members))


def _with_sensor(config: Config, options: argparse.Namespace) -> Config:
    """The configuration with the own sensor in the roster, if the command line names one."""
    sensor_class = getattr(options, "sensor", "")
    return msgspec.structs.replace(config, members={**config.members, options.name: sensor_class}) if sensor_class else config


def main(
    role: str,
    into: type[Config],
    build: Callable[[Config, str, int], Role],
    on_line: Callable[[Role, str], None] | None = None,
    at_end: Callable[[Role], None] = lambda node: None,
) -> NoReturn:
    """Run one process: read the configuration, build the node, drive it, leave with its exit code; that of a BadSetting.

    `on_line` takes the lines that a parent writes to the standard input. Without it they set the link faults. `at_end` is called when
    the node is driven no more, but for an error in it.
    """
    options = arguments(role)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # until the driver takes signals: loops may have to be compiled first
        signal.signal(signal.SIGINT, lambda number, frame: leave(130))
    if options.supervised:
        die_with_parent()
    sys.path.append(os.environ.get("COVEY_MODULES", "."))  # the folder of a user's own sensor models and control laws
    try:
        config = _with_sensor(load(options.config, into), options)
        log_json_lines(config.run.name, options.name)
        if role == "agents" and config.run.clock == "lockstep":
            use_batch_scheduling()
        incarnation = options.incarnation if options.incarnation is not None else time.time_ns() // 1_000_000
        node = build(config, options.name, incarnation)
        link = LiveLink(config.shared_seed, options.name, logging.getLogger(__name__).warning) if config.network.link_faults else None
        hear = partial(on_line, node) if on_line else link.on_line if link else None
        code = live.run(node, network_of(config, options), watch_stdin=options.supervised, on_line=hear, link=link)
        at_end(node)
    except BadSetting as error:
        if error.__cause__ is not None:  # an error inside a class of the user's own: the log shows its traceback
            logging.getLogger(__name__).error("%s", error, exc_info=error.__cause__)
        print(f"{role}: {error}", file=sys.stderr)
        code = error.exit_code
    except Exception:
        logging.getLogger(__name__).exception("the process ends on an error of its own")
        code = 1
    leave(code)
