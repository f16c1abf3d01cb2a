"""The injector: carries out faults on the agents of a simulation.

What the network would do to liveliness tokens is done here as well. The token of a stopped process, or of one behind a cut, is lost after
`network.lease` s. It is seen again when the process goes on, or shortly after the cut has healed.
"""

from collections.abc import Callable, Iterable
from functools import partial

import msgspec

from agents.agent import Agent
from agents.backend import Backend
from agents.config import AgentConfig
from deploy.faults.faults import LINK_VERBS, Action
from deploy.faults.links import Links
from deploy.scenario import Scenario, agent_config
from protocol.node import Alive, Gone
from protocol.random_streams import stream
from protocol.settings import BadSetting
from protocol.virtual import VirtualBus

RECONNECT = 0.5  # s from the end of a cut to the new session
Pair = tuple[str, str]
Build = Callable[[AgentConfig, str, int, Backend, str], Agent]  # from what agents know, a name, an incarnation and a sensor class


class Injector:
    """Starts, kills and disturbs agents on a virtual bus."""

    def __init__(self, bus: VirtualBus, links: Links, scenario: Scenario, backend: Backend, build: Build = Agent) -> None:
        self.agents: dict[str, Agent] = {}  # by label: the name, or s3#2 for the second of a name
        self._bus, self._links = bus, links
        self._backend, self._build = backend, build
        self.scenario = scenario  # members include newcomers, which the configuration of agents does not name
        self._config = agent_config(scenario)
        self._incarnations = dict.fromkeys(scenario.members, 0)
        self._pauses: dict[str, int] = {}  # label -> number of the pause it is in
        self._unseen: set[str] = set()  # stopped for so long that their tokens are lost
        self._tearing: dict[Pair, int] = {}  # pairs of labels with a cut between them -> number of the cut
        self._torn: set[Pair] = set()  # whose sessions are lost
        self._number = 0
        bus.apart = self._apart

    def alive(self) -> list[str]:
        """Names of the living."""
        self._forget_the_stopped()
        return list(dict.fromkeys(agent.name for agent in self.agents.values()))

    def _awake(self) -> list[str]:
        """Names of the living that are not paused."""
        return [name for name in self.alive() if any(label not in self._pauses for label in self._labels(name))]

    def dead(self) -> list[str]:
        """Names of those that are not there, in team order."""
        alive = set(self.alive())
        return [name for name in self._incarnations if name not in alive]

    def strike(self, action: Action) -> None:
        """Carry out a fault; one that no longer applies, such as killing a dead agent, has no effect."""
        if action.verb in LINK_VERBS:
            self._bus.link = self._bus.link or self._links  # from the first link fault on: to ask for every message takes time
            if self._bus.link is not self._links:
                raise BadSetting(f"{action.verb}: a simulation with a link of its own has no other faults of links")
            self._links.act(action, self._awake())
            self._look_at_sessions()
            return
        if action.verb == "freeze":
            self._freeze(action.value or 0.0)
            return
        for name in action.names:
            if action.verb == "join":
                self._join(name, str(action.options["class"]))
            elif action.verb == "restart" and name in self.dead():
                self.start(name)
            elif action.verb == "twin" and name in self.alive():
                self.start(name, twin=True)
            for label in self._labels(name):
                self._strike(action, label)

    def start(self, name: str, twin: bool = False) -> None:
        """A new incarnation of an agent starts, beside the old one if it is to be a twin."""
        self._incarnations[name] += 1
        label = f"{name}#{self._incarnations[name]}" if twin else name
        self._bus.stopped.pop(label, None)
        self.agents[label] = self._build(self._config, name, self._incarnations[name], self._backend, self.scenario.members[name])
        for other in self.agents:
            if self._cut(label, other):
                self._tear(self._pair(label, other))
        self._bus.add(self.agents[label], label)

    def kill(self, label: str, silent: bool = False) -> None:
        """An agent vanishes; the others see its token go, or only world and watchers do."""
        agent = self.agents.pop(label)
        self._forget(label)
        self._bus.remove(label, notice_after=None if silent else 0.0)
        if silent:
            watchers = [other for other in self._bus.nodes() if other not in self.agents]
            self._bus.announce(Gone("agent", agent.name, agent.incarnation), to=watchers)

    def _strike(self, action: Action, label: str) -> None:
        value = action.value or 0.0
        match action.verb:
            case "kill":
                self.kill(label, silent=bool(action.options.get("silent", False)))
            case "pause" if label not in self._pauses:
                self._pause(label)
            case "resume" if label in self._pauses:
                self._resume(label)
            case "slow":
                self._bus.slow(label, (lambda: value) if value > 0.0 else None)
            case "starve":
                self._starve(label, value)
            case "jump":
                self._bus.jump(label, -value if action.options.get("back") else value)

    def _starve(self, label: str, share: float) -> None:
        """Every round takes a period of the world, on average, divided by the share of the time that the agent gets; 0 ends it."""
        run = self.scenario.run
        rng = stream(run.seed, f"starve {label}")
        mean = run.dt / run.rate / share if share > 0.0 else 0.0
        self._bus.slow(label, (lambda: mean * float(0.5 + rng.random())) if share > 0.0 else None, published_after=0.5)

    def _freeze(self, seconds: float) -> None:
        """All nodes stand still. After more than the lease every session between agents is lost, and opened again."""
        self._bus.freeze(seconds)
        if seconds <= self.scenario.network.lease:
            return
        for pair in self._pairs():
            for one, other in (pair, pair[::-1]):
                agent = self.agents[one]
                self._bus.announce(Gone("agent", agent.name, agent.incarnation), seconds, to=[other])
            self._bus.call_later(seconds + RECONNECT, partial(self._reopen, *pair))

    def _join(self, name: str, sensor_class: str) -> None:
        if name in self._incarnations:
            return
        self._incarnations[name] = 0
        self.scenario = msgspec.structs.replace(self.scenario, members={**self.scenario.members, name: sensor_class})
        self._links.add(name)
        self.start(name)

    # ------------------------------------------------------------------ tokens

    def _pause(self, label: str) -> None:
        self._bus.pause(label)
        self._number += 1
        number = self._pauses[label] = self._number
        self._bus.call_later(self.scenario.network.lease, partial(self._lose_sight, label, number))

    def _lose_sight(self, label: str, number: int) -> None:
        """A process has been stopped for the lease: all its sessions are lost."""
        if self._pauses.get(label) != number:
            return
        self._unseen.add(label)
        agent = self.agents[label]
        self._bus.announce(Gone("agent", agent.name, agent.incarnation))
        for other in self._others(label):
            self._bus.announce(Gone("agent", other.name, other.incarnation), to=[label])

    def _resume(self, label: str) -> None:
        del self._pauses[label]
        self._bus.resume(label)
        if label not in self._unseen:
            return
        self._unseen.discard(label)
        for other in [other for other in self.agents if other != label]:
            self._reopen(label, other)
        agent = self.agents[label]
        self._bus.announce(
            Alive("agent", agent.name, agent.incarnation), to=[node for node in self._bus.nodes() if node not in self.agents]
        )

    def _look_at_sessions(self) -> None:
        """After a change of the links: sessions across a new cut are lost after the lease, those across a healed one come back."""
        for pair in self._pairs():
            if self._cut(*pair) and pair not in self._tearing:
                self._number += 1
                self._tearing[pair] = self._number
                self._bus.call_later(self.scenario.network.lease, partial(self._lose, pair, self._number))
            elif not self._cut(*pair) and pair in self._tearing:
                del self._tearing[pair]
                self._bus.call_later(RECONNECT, partial(self._mend, pair))

    def _lose(self, pair: Pair, number: int) -> None:
        if self._tearing.get(pair) == number:
            self._tear(pair)

    def _tear(self, pair: Pair) -> None:
        """Both lose sight of each other."""
        self._tearing.setdefault(pair, 0)
        self._torn.add(pair)
        for one, other in (pair, pair[::-1]):
            self._bus.announce(Gone("agent", self.agents[one].name, self.agents[one].incarnation), to=[other])

    def _mend(self, pair: Pair) -> None:
        """Both see each other again, unless they have been cut off anew."""
        if pair not in self._torn or pair in self._tearing:
            return
        self._torn.discard(pair)
        self._reopen(*pair)

    def _reopen(self, one: str, other: str) -> None:
        """Two see each other's tokens, or will when the cut or the stop that keeps them apart ends; without effect when one is gone."""
        if one not in self.agents or other not in self.agents:
            return
        if self._cut(one, other):
            self._torn.add(self._pair(one, other))
        if self._apart(one, other):
            return
        for label, viewer in ((one, other), (other, one)):
            self._bus.announce(Alive("agent", self.agents[label].name, self.agents[label].incarnation), to=[viewer])

    def _pair(self, one: str, other: str) -> Pair:
        return (one, other) if one < other else (other, one)

    def _pairs(self) -> list[Pair]:
        labels = sorted(self.agents)
        return [(one, other) for number, one in enumerate(labels) for other in labels[number + 1 :]]

    def _apart(self, one: str, other: str) -> bool:
        """Whether two labels have no session."""
        return not self._unseen.isdisjoint((one, other)) or self._pair(one, other) in self._torn

    def _cut(self, one: str, other: str) -> bool:
        """Whether the session between two labels has been cut."""
        return one != other and self._links.torn(one.partition("#")[0], other.partition("#")[0])

    def _others(self, label: str) -> Iterable[Agent]:
        return [agent for other, agent in self.agents.items() if other != label]

    def _labels(self, name: str) -> list[str]:
        return [label for label, agent in self.agents.items() if agent.name == name]

    def _forget_the_stopped(self) -> None:
        for label in [label for label in self.agents if label in self._bus.stopped]:
            del self.agents[label]
            self._forget(label)

    def _forget(self, label: str) -> None:
        """Remove all state of a label."""
        self._pauses.pop(label, None)
        self._unseen.discard(label)
        self._tearing = {pair: number for pair, number in self._tearing.items() if label not in pair}
        self._torn = {pair for pair in self._torn if label not in pair}
