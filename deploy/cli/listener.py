"""Listening to a running swarm from outside: key expressions, a node that forwards all it receives, and message rates."""

import itertools
import re
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

from msgspec import structs

from deploy.scenario import Scenario, resolve
from deploy.storage.run_directory import RunDirectory, find_running
from protocol.keys import ROOT, message_key
from protocol.message import Message
from protocol.node import Alive, Effect, Event, Gone, Node, Received, Rejected, Started, Stop, Subscribe, Timer, Unsubscribe
from protocol.settings import BadSetting, load

SILENCE = 3.0  # s without a message after which the listener looks for other keys
LOOK = 2.0  # s of that search: the rarest messages come about once a second
PART = re.compile(r"^(\*\*?|[^*/#?$\s]+(\$\*[^*/#?$\s]*)*|\$\*[^*/#?$\s]+)\Z")


class KeyedPayload(NamedTuple):
    """A payload under a key: `message` when it decodes, `reason` when it does not."""

    key: str
    payload: bytes
    message: Message | None
    reason: str


def swarm_to_watch(run: str | None, *, supervised: bool = False) -> tuple[RunDirectory | None, Scenario]:
    """The running run of that name, or the newest, and its resolved scenario, which says where the swarm is found.

    With `supervised` it is one that has processes, and no recording that is said again.
    A name that ends in .toml is the file of a swarm on other machines. No supervisor is here then, and no run directory.
    """
    if run is not None and run.endswith(".toml"):
        return None, swarm_elsewhere(run)
    directory = find_running(run, supervised=supervised)
    try:
        return directory, load(directory.config, Scenario)
    except BadSetting:
        raise BadSetting(f"--run {directory.name}: the run is starting or ending; try again in a second") from None


def swarm_elsewhere(file: str) -> Scenario:
    """The scenario of a swarm that runs on other machines; raises BadSetting where it does not say how to reach them."""
    scenario = resolve(file)
    if not scenario.network.seeds:
        raise BadSetting(f"--run {file}: network.seeds is empty; should hold the endpoints of the swarm, such as 'tls/10.0.0.1:7447'")
    admitted = scenario.network.admit or tuple(scenario.members)
    return structs.replace(scenario, network=structs.replace(scenario.network, admit=admitted))


def expression(text: str, run: str) -> str:
    """A key expression: as given when it begins with covey/ or with **/, else within the run. Raises BadSetting."""
    parts = text.strip("/").split("/")
    if not all(PART.match(part) for part in parts) or any(pair == ("**", "**") for pair in itertools.pairwise(parts)):
        raise BadSetting(f"{text!r}: should be a key expression such as truth, estimate/s3, 'gossip/*' or '{ROOT}/**'")
    return "/".join(parts if parts[0] == ROOT or (parts[0] == "**" and len(parts) > 1) else [ROOT, run, *parts])


def lies_in(expression: str, key: str) -> bool:
    """Whether a key lies in a key expression: `*` is one part, `**` any number of parts, `$*` any piece of a part."""
    wild = {"**": "(/[^/]+)*", "*": "/[^/]+"}
    parts = [wild.get(part) or "/" + re.escape(part).replace(r"\$\*", "[^/]*") for part in expression.split("/")]
    return re.fullmatch("".join(parts), f"/{key}") is not None


class Listener(Node):
    """The Node of `echo`, `hz` and `ls`: subscribes to one expression, hands on what it hears, stops after `seconds` or on demand."""

    role = "monitor"
    incarnation = 1

    def __init__(
        self,
        run: str,
        name: str,
        wanted: str,
        on_heard: Callable[[KeyedPayload, float], bool],
        seconds: float | None = None,
        on_silence: Callable[[list[str]], None] | None = None,
    ) -> None:
        """`on_heard` returns whether to continue. `on_silence` is called once after a silence, with the keys that do have messages."""
        self.run, self.name = run, name
        self.tokens: set[tuple[str, str, int]] = set()  # role, name, incarnation of live processes
        self._wanted, self._on_heard, self._seconds = wanted, on_heard, seconds
        self._all = f"{ROOT}/{run}/**"
        self._end: float | None = None
        self._on_silence = on_silence
        self._look: float | None = None  # when to search other keys, or to report them
        self._looked = False
        self._elsewhere: set[str] | None = None  # keys found while the search runs

    def deadline(self) -> float | None:
        """When the time is up, or a silence has to be reported."""
        return min((at for at in (self._end, self._look) if at is not None), default=None)

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do."""
        match event:
            case Started():
                self._end = now + self._seconds if self._seconds is not None else None
                self._look = now + SILENCE if self._on_silence is not None else None
                return [Subscribe(self._wanted)]
            case Timer():
                return [Stop(0, "time is up")] if self._end is not None and now >= self._end else self._look_around(now)
            case Received(batch=batch):
                heard = [KeyedPayload(message_key(self.run, one), payload, one, "") for one, payload in zip(batch.messages, batch.payloads)]
                effects: list[Effect] = []
                for one in heard:
                    effects += self._hear(one, now)
                    if effects and isinstance(effects[-1], Stop):  # enough: the rest of the batch is not wanted
                        break
                return effects
            case Rejected():
                return self._hear(KeyedPayload(event.key, event.payload, None, event.reason), now)
            case Alive():
                self.tokens.add((event.role, event.name, event.incarnation))
            case Gone():
                self.tokens.discard((event.role, event.name, event.incarnation))
        return []

    def _hear(self, heard: KeyedPayload, now: float) -> list[Effect]:
        """Forward a wanted payload; note the key of any other while the search runs."""
        if self._looked and not lies_in(self._wanted, heard.key):
            if self._elsewhere is not None:
                self._elsewhere.add(heard.key)
            return []  # also late payloads of a search that has ended
        effects: list[Effect] = [] if self._elsewhere is None else [Subscribe(self._wanted), Unsubscribe(self._all)]
        self._elsewhere = None
        self._look = None
        return effects if self._on_heard(heard, now) else [*effects, Stop(0, "enough")]

    def _look_around(self, now: float) -> list[Effect]:
        """After a silence listen to all keys for a moment, report them, and return to the wanted key."""
        if self._look is None or now < self._look:
            return []
        if self._elsewhere is None and self._wanted != self._all:
            self._looked, self._elsewhere, self._look = True, set(), now + LOOK
            return [Unsubscribe(self._wanted), Subscribe(self._all)]
        keys, self._elsewhere, self._look = self._elsewhere or set(), None, None
        assert self._on_silence is not None
        self._on_silence(sorted(keys))
        return [Subscribe(self._wanted), Unsubscribe(self._all)] if self._wanted != self._all else []


def kinds(keys: list[str]) -> str:
    """Keys of one run in few words: `truth, gossip/** (16 keys)`; one that names the run alone is none of its kinds."""
    rests = [key.split("/", 2)[2] for key in keys if key.count("/") > 1]
    counts, alone = Counter(rest.partition("/")[0] for rest in rests), {*rests}
    return ", ".join(kind if kind in alone else f"{kind}/** ({number} key{'s' * (number != 1)})" for kind, number in sorted(counts.items()))


class Rates:
    """Message rates and sizes by key."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.bytes: dict[str, int] = {}
        self._first: dict[str, float] = {}
        self._last: dict[str, float] = {}
        self._longest: dict[str, float] = {}

    def note(self, heard: KeyedPayload, now: float) -> bool:
        """Count one message; always True: the listener continues."""
        key = heard.key
        if key in self._last:
            self._longest[key] = max(self._longest.get(key, 0.0), now - self._last[key])
        self._first.setdefault(key, now)
        self._last[key] = now
        self.counts[key] = self.counts.get(key, 0) + 1
        self.bytes[key] = self.bytes.get(key, 0) + len(heard.payload)
        return True

    def rows(self) -> list[tuple[str, float | None, float | None, float]]:
        """(key, messages per s, longest gap in s, bytes per message) by key; no rate from a single message."""
        found: list[tuple[str, float | None, float | None, float]] = []
        for key in sorted(self.counts, key=lambda key: [(len(part), part) for part in key.split("/")]):
            span = self._last[key] - self._first[key]
            rate = (self.counts[key] - 1) / span if span > 0.0 else None
            found.append((key, rate, self._longest.get(key), self.bytes[key] / self.counts[key]))
        return found
