"""The world process: `python -m world --config run.toml [--incarnation N] [--keep FILE] [--restore FILE] [--keep-halt FILE]`.

`python -m world --body s3 --config run.toml [--keep FILE] [--restore FILE]` is the part for the agent s3 alone: its body.

With `--keep` the newest Truth stands in FILE, so that a world that was killed can be started again where it stopped with `--restore`.
With `--keep-halt`, and with `--keep` of a body, the newest Halt stands in FILE: who was halted stands when it is started again.
"""

import argparse
import contextlib
import logging
import sys
import time
from pathlib import Path
from typing import NoReturn

from protocol import codec, process
from protocol.fields import Malformed
from protocol.keys import all_of
from protocol.messages import Halt
from protocol.observer_messages import Truth
from protocol.settings import BadSetting
from protocol.whole_file import write_whole
from world.body import Body, check_epoch
from world.config import WorldConfig
from world.halt import Hold
from world.world import World

log = logging.getLogger(__name__)


def read_halt(path: Path, run: str) -> Halt:
    """The halt that was kept in a file; raises BadSetting naming the file."""
    try:
        message = codec.decode(all_of(run, "halt"), path.read_bytes())
    except OSError as error:
        raise BadSetting(f"{path}: {error.strerror}") from None
    except Malformed as error:
        raise BadSetting(f"{path}: no kept Halt: {error}; remove it only when all may move") from None
    assert isinstance(message, Halt)
    return message


def keep_halts(hold: Hold, path: Path, run: str) -> None:
    """Let a hold begin with the order that a file holds, and write every later order that counts to it."""
    if path.exists():
        hold.take(read_halt(path, run))

    def keep(halt: Halt) -> None:
        try:
            write_whole(path, codec.encode(halt))
        except OSError as error:
            which = "the order before it is what a restart finds" if path.exists() else "a restart finds no order"
            log.warning("%s: %s; this %s is not kept, and %s", path, error.strerror, "halt" if halt.held else "release", which)

    hold.on_order = keep


def keep_truths(world: World, path: Path) -> None:
    """Write every Truth to a file before it is published; a full disk ends the keeping, not the world."""

    def keep(truth: Truth) -> None:
        try:
            write_whole(path, codec.encode(truth))
        except OSError as error:
            log.warning("%s: %s; no Truth is kept from here on", path, error.strerror)
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)  # an old one would lead a restarted world back in time
            world.on_truth = lambda truth: None

    world.on_truth = keep


def read_truth(path: Path, run: str) -> Truth:
    """The Truth that was kept in a file, its bytes as on the wire; raises BadSetting naming the file."""
    try:
        message = codec.decode(all_of(run, "truth"), path.read_bytes())
    except OSError as error:
        raise BadSetting(f"--restore {path}: {error.strerror}") from None
    except Malformed as error:
        raise BadSetting(f"--restore {path}: no kept Truth: {error}") from None
    assert isinstance(message, Truth)
    return message


def main() -> NoReturn:
    """Be the world process, or that of one body."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--restore", type=Path)
    parser.add_argument("--keep-halt", type=Path)
    parser.add_argument("--body")
    own, sys.argv[1:] = parser.parse_known_args()  # the rest is common to all processes

    if own.body is not None:
        be_body(own.body, own.keep, own.restore)

    def build(config: WorldConfig, name: str, incarnation: int) -> World:
        if name != World.name:
            raise BadSetting(f"--name {name}: the world of a run is always called {World.name}")
        if config.bodies.host == "own":
            raise BadSetting("bodies.host = 'own': every agent has a body process and nothing is called world; should be --body NAME")
        restored = read_truth(own.restore, config.run.name) if own.restore else None
        if own.keep and not own.restore:
            own.keep.unlink(missing_ok=True)  # of an earlier run: nobody shall go on from that
        world = World(config, incarnation, restored)
        if own.keep_halt:
            keep_halts(world.hold, own.keep_halt, config.run.name)
        if own.keep:
            keep_truths(world, own.keep)
        return world

    process.main("world", WorldConfig, build, lambda world, line: world.expect(tuple(line.split())), log_counts)


def be_body(name: str, keep: Path | None, restore: Path | None) -> NoReturn:
    """Be the process of the body of one agent. With `restore` a simulated one begins at its pose in that Truth.

    The file `keep` holds the newest halt.
    """
    sys.argv += ["--name", name]

    def build(config: WorldConfig, name: str, incarnation: int) -> Body:
        if config.bodies.host != "own":
            raise BadSetting(f"bodies.host = {config.bodies.host!r}: should be 'own' for --body; is this the run.toml of the scenario?")
        check_epoch(config, time.time())
        unix = time.time() - time.monotonic()  # read once: a clock that is set while the body runs moves no tick
        body = Body(config, name, incarnation, unix, read_truth(restore, config.run.name) if restore else None)
        if keep is not None:
            keep_halts(body.hold, keep, config.run.name)
        return body

    process.main("world", WorldConfig, build, lambda body, line: body.expect(tuple(line.split())), end_body)


def end_body(body: Body) -> None:
    """Stop the platform, and log what was counted."""
    body.end()
    log_counts(body)


def log_counts(node: World | Body) -> None:
    """Log at the end of a process what went wrong in it, once."""
    log.info("the process ends", extra=node.counts())


if __name__ == "__main__":
    main()
