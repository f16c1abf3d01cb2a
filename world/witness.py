"""The witness: the Truth of a run without a world, computed by whoever wants to know it.

The targets of a tick are a function of the seed. The poses are in the observations of that tick. So a scorer, a page or a recorder finds
the Truth that a world would say, and nothing of it is sent.
"""

from protocol.messages import Observation
from protocol.node import Alive, Event, Gone, messages_of
from protocol.observer_messages import Truth
from protocol.sensing import Pose
from protocol.settings import sensor_of
from world.bodies import start_poses
from world.config import WorldConfig
from world.newest_tick import NewestTick
from world.scene import Scene


class Witness:
    """Turns the events of a watcher into Truths."""

    def __init__(self, config: WorldConfig, name: str, incarnation: int, lag: int, lag_seconds: float) -> None:
        """`lag`: a tick is not waited for any more when some body is so many ticks ahead, and has been for `lag_seconds`."""
        self._name, self._incarnation, self._lag = name, incarnation, lag
        self._ticks = config.run.ticks
        self._ahead = NewestTick(lag_seconds)
        self._scene = Scene(config)
        self._poses: dict[str, Pose] = start_poses(config)
        for member, sensor_class in config.members.items():
            self._scene.sensors[member] = sensor_of(config, sensor_class)
        self._seen: dict[int, dict[str, Pose]] = {}  # tick -> poses by name
        self._newest: dict[str, int] = {}  # name -> newest tick of its body
        self._alive: dict[str, set[tuple[str, int]]] = {"agent": set(), "body": set()}  # by role: name and incarnation
        self._unseen = set(config.members)  # whose agents' tokens have never been seen
        self._next = 0

    def take(self, event: Event, now: float) -> list[Truth]:
        """The Truths that an event completes, in the order of ticks."""
        if isinstance(event, Alive | Gone):
            tokens = self._alive.get(event.role, set())
            (tokens.add if isinstance(event, Alive) else tokens.discard)((event.name, event.incarnation))
            if event.role == "agent":
                self._unseen.discard(event.name)
        for message in messages_of(event):
            if isinstance(message, Observation) and message.recipient in self._poses and self._next <= message.tick < self._ticks:
                self._seen.setdefault(message.tick, {})[message.recipient] = message.pose
                self._newest[message.recipient] = max(message.tick, self._newest.get(message.recipient, -1))
                self._ahead.hear(message.tick, now)
        truths: list[Truth] = []
        while self._seen and self._is_complete(min(self._seen), now):
            truths.append(self._truth(min(self._seen)))
        return truths

    def _is_complete(self, tick: int, now: float) -> bool:
        """Whether every body that is alive has been at the tick, or some body is far beyond it.

        Before the first tick the agents are waited for as well: those whose tokens are not here by then count as missing.
        """
        if self._ahead.at(now) < tick + self._lag:
            bodies = {name for name, _ in self._alive["body"]}
            if self._unseen or not all(self._newest.get(name, -1) >= tick for name in bodies):
                return False
        self._unseen.clear()
        return True

    def _truth(self, tick: int) -> Truth:
        seen = self._seen.pop(tick)
        self._poses.update(seen)
        self._next = tick + 1
        self._scene.step_until(tick)
        agents = {name for name, _ in self._alive["agent"]}
        present = {name: pose for name, pose in self._poses.items() if name in seen and name in agents}
        return self._scene.truth(self._poses, self._scene.in_view(present), present, self._name, self._incarnation)
