"""The world process: `python -m world --config run.toml [--incarnation N] [--keep FILE] [--restore FILE]`.

With `--keep` the newest Truth stands in FILE, so that a world that was killed can be started again where it stopped with `--restore`.
"""

import argparse
import logging
import sys
from pathlib import Path
from typing import NoReturn

from protocol import codec, process
from protocol.fields import Malformed
from protocol.keys import all_of
from protocol.messages import Truth
from protocol.node import Effect, Event, Node
from protocol.settings import BadSetting
from world.config import WorldConfig
from world.world import World

log = logging.getLogger(__name__)


class KeptWorld(Node):
    """A world whose newest Truth is in a file before anybody hears of it; a full disk ends the keeping, not the world."""

    def __init__(self, world: World, path: Path) -> None:
        self.run, self.role, self.name, self.incarnation, self.patient = world.run, world.role, world.name, world.incarnation, world.patient
        self._world = world
        self._path: Path | None = path

    def handle(self, event: Event, now: float) -> list[Effect]:
        """What the world does, its Truth kept on the way."""
        effects = self._world.handle(event, now)
        for effect in effects:
            if isinstance(effect, Truth):
                self._keep(effect)
        return effects

    @property
    def awaiting(self) -> int:
        """As the world says."""
        return self._world.awaiting

    def deadline(self) -> float | None:
        """As the world says."""
        return self._world.deadline()

    def expect(self, names: tuple[str, ...]) -> None:
        """As the world does."""
        self._world.expect(names)

    def _keep(self, truth: Truth) -> None:
        if self._path is None:
            return
        fresh = self._path.with_name(self._path.name + ".new")
        try:
            fresh.write_bytes(codec.encode(truth))
            fresh.replace(self._path)  # in one step, so that the file is always whole
        except OSError as error:
            log.warning("%s: %s; the truth is no longer kept", self._path, error.strerror, extra={"tick": truth.tick})
            self._path = None


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
    """Be the world process."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--restore", type=Path)
    own, sys.argv[1:] = parser.parse_known_args()  # the rest is common to all processes

    def build(config: WorldConfig, name: str, incarnation: int) -> World | KeptWorld:
        if name != World.name:
            raise BadSetting(f"--name {name}: the world of a run is always called {World.name}")
        restored = read_truth(own.restore, config.run.name) if own.restore else None
        if own.keep and not own.restore:
            own.keep.unlink(missing_ok=True)  # of an earlier run: nobody shall go on from that
        world = World(config, incarnation, restored)
        return KeptWorld(world, own.keep) if own.keep else world

    process.main("world", WorldConfig, build, lambda world, line: world.expect(tuple(line.split())))


if __name__ == "__main__":
    main()
