"""The watchdog of one node over its own session: which peers it receives, and whether the session is half open.

Two Zenoh peers that lose and regain each other can be left with half a session: one or both receive nothing any more (zenoh issue
2806). A node alone cannot tell this from a death. The Hellos of the others can: each lists the peers that its sender receives. Each of two
signs is an alarm, upon which the session is opened anew. One: at least half of the received peers list a peer that is silent here. The
other: a peer goes on sending Hellos after its token has vanished, for half a session may carry messages, but no tokens.
"""

from collections.abc import Collection, Iterable

from protocol.messages import Gossip, Hello
from protocol.node import NO_EFFECTS, Alive, Effect, Event, Gone, Received, Reopen

HEARD_LATELY = 3.0  # s since the last message; agents send a Hello every 2 s, in crowds every 4 s
LISTED_LATELY = 5.0  # s since the last Hello that listed a name
PATIENCE = 5.0  # s for which a sign must last before it is an alarm, at least; the lease of the links, if that is longer
FIRST_REST, LONGEST_REST = 20.0, 320.0  # s between two alarms, at first and at most
MOST_GUESTS = 4096  # agents with a token that are not expected: anybody can make up names

NEVER = -float("inf")


def patience_of(lease: float) -> float:
    """For how long a sign must last, s. A link that became slow may be silent for its `lease`, and a new session would be as slow."""
    return max(PATIENCE, lease)


class AlarmRest:
    """The rest after an alarm, twice as long after each: false words of others must not keep a node busy."""

    def __init__(self) -> None:
        self._length, self._end = FIRST_REST, NEVER

    def is_over(self, now: float) -> bool:
        """Whether another alarm may be made."""
        return now >= self._end

    def begin(self, now: float) -> None:
        """Note that an alarm has been made."""
        self._end, self._length = now + self._length, min(2.0 * self._length, LONGEST_REST)


class SessionWatchdog:
    """The peers that one node receives, and the alarms about its session.

    Times are `now` of that node, s. A clock that jumps back delays an alarm.
    """

    def __init__(self, name: str, expected: Iterable[str], lease: float) -> None:
        """`expected`: the names that can count as silent; `lease`: s for which a link may be silent."""
        self._name, self._expected, self._patience = name, tuple(expected), patience_of(lease)
        self._words: dict[str, float] = {}  # name -> time of its last message
        self._up: dict[str, int] = {}  # name -> youngest incarnation with a token that has been seen
        self._lost: dict[str, float | None] = {}  # name without a token -> time since which its Hellos arrive all the same
        self._announced: set[str] = set()  # names from which a Hello has arrived
        self._listed_by: dict[str, dict[str, float]] = {}  # silent name -> peers that list it, and the time of their last Hello that did
        self._since: dict[str, float] = {}  # silent name -> time since which some peer lists it
        self._voters: set[str] = set()  # senders of the Hellos that `reason_to_reopen` has taken
        self._rest = AlarmRest()
        self._calm_until = NEVER  # until then no expected name can be silent

    def note_messages(self, names: Iterable[str], now: float) -> None:
        """Note a message of each of some peers."""
        self._words.update(dict.fromkeys(names, now))

    def note_hello(self, name: str, now: float) -> bool:
        """Note a Hello of a peer; True for its first one."""
        self._words[name] = now
        first = name not in self._announced
        self._announced.add(name)
        return first

    def token_appeared(self, name: str, incarnation: int) -> None:
        """Note that the token of a peer has appeared."""
        self._up[name] = max(incarnation, self._up.get(name, 0))
        self._lost.pop(name, None)

    def token_vanished(self, name: str, incarnation: int) -> None:
        """Note that the token of a peer has vanished: the peer counts as silent until its next message."""
        self._words.pop(name, None)
        self._calm_until = NEVER
        if incarnation >= self._up.get(name, 0):  # not the late end of an older incarnation
            self._lost[name] = None

    def keep(self, names: Collection[str]) -> None:
        """Forget all names but these and the expected ones: anybody can make up names."""
        known = {*names, *self._expected}
        for name in {*self._words, *self._up, *self._lost, *self._announced, *self._voters} - known:
            for table in (self._words, self._up, self._lost):
                table.pop(name, None)
            self._announced.discard(name)
            self._voters.discard(name)

    def heard(self, now: float | None = None) -> tuple[str, ...]:
        """The names for the own Hello: peers that sent a Hello, have not left, and sent a message lately; `now` None: at any time."""
        words, announced = self._words, self._announced
        if now is None:
            return tuple(sorted([name for name in announced if name in words]))
        return tuple(sorted([name for name in announced if now - words.get(name, NEVER) <= HEARD_LATELY]))

    def reason_to_reopen(self, hello: Hello, now: float) -> str:
        """Take a Hello of a peer; the reason to open the session anew, empty if there is none."""
        self._voters.add(hello.sender)
        alarm = self._tokenless(hello.sender, now) if hello.sender in self._lost else ""
        if not alarm and now > self._calm_until:
            alarm = self._silent(hello, now)
        if alarm:
            self._listed_by.clear()
            self._since.clear()
            self._lost.clear()
            self._rest.begin(now)
        return alarm

    def _tokenless(self, name: str, now: float) -> str:
        """The alarm that a peer goes on sending Hellos without a token; empty if there is none."""
        since = self._lost[name]
        if since is None or since > now:
            since = self._lost[name] = now
        late = now - since >= self._patience and self._rest.is_over(now)
        return f"{name} speaks, but its token has gone" if late else ""

    def _silent(self, hello: Hello, now: float) -> str:
        """The alarm that most peers list a name that is silent here; empty if there is none."""
        alarm = ""
        silent = [name for name in self._find_silent(now) if name != hello.sender]
        for name in self._since.keys() - silent:
            del self._listed_by[name], self._since[name]
        spoken_of = self._since.keys() | hello.heard  # at the start most names are silent, and no peer lists them yet
        for name in silent:
            if name in spoken_of and self._is_split(name, hello, now):
                alarm = f"the others hear {name}, {self._name} does not"
        return alarm

    def _find_silent(self, now: float) -> list[str]:
        """The expected names that are silent. If there is none, and no peer lists one, none can be silent for a while."""
        words, own = self._words, self._name
        silent = [name for name in self._expected if not now - words.get(name, NEVER) <= HEARD_LATELY and name != own]
        if not silent and not self._since:
            self._calm_until = min([words[name] for name in self._expected if name != own], default=now) + HEARD_LATELY
        return silent

    def _is_split(self, name: str, hello: Hello, now: float) -> bool:
        """Note whether a Hello lists a silent name; True when enough peers have listed it for long enough."""
        lists = {other: when for other, when in self._listed_by.get(name, {}).items() if now - when <= LISTED_LATELY}
        if not lists:
            self._since[name] = now  # no peer has listed it lately
        if name in hello.heard:
            lists[hello.sender] = now
        else:
            lists.pop(hello.sender, None)
        self._listed_by[name] = lists
        if not lists:
            del self._listed_by[name], self._since[name]
            return False
        if now - self._since[name] < self._patience or not self._rest.is_over(now):
            return False
        voters = sum(now - self._words.get(other, NEVER) <= HEARD_LATELY for other in self._voters if other != name)
        return 2 * len(lists) >= voters


class ListenerWatchdog:
    """The watchdog of a participant that says no Hello: a body, a scorer, a recorder. Half a session shows it living agents as dead."""

    def __init__(self, members: Iterable[str], lease: float) -> None:
        """`members`: the agents that are expected. Others count once their token has been seen, for anybody can make up names.

        `lease`: s for which a link may be silent.
        """
        self._agents = set(members)
        self._guests: dict[str, None] = {}  # other agents that had a token, the earliest first
        self._watchdog = SessionWatchdog("this session", self._agents, lease)

    def take(self, event: Event, now: float) -> list[Effect]:
        """Take an event; a `Reopen` if the Hellos in it say that the own session is half open."""
        match event:
            case Alive(role="agent"):
                if event.name not in self._agents:
                    self._admit(event.name)
                self._watchdog.token_appeared(event.name, event.incarnation)
            case Gone(role="agent"):
                self._watchdog.token_vanished(event.name, event.incarnation)
            case Received(batch=batch) if batch.kind in (Gossip, Hello):
                known = self._agents.intersection(batch.senders)
                self._watchdog.note_messages(known, now)
                if batch.kind is Hello:
                    return self._judge(batch.messages, known, now)
        return NO_EFFECTS

    def _admit(self, guest: str) -> None:
        """Let an agent count that is not expected. Of too many the earlier half is forgotten."""
        self._agents.add(guest)
        self._guests[guest] = None
        if len(self._guests) > MOST_GUESTS:
            earlier = [*self._guests][: MOST_GUESTS // 2]
            self._agents.difference_update(earlier)
            self._guests = {name: None for name in self._guests if name in self._agents}
            self._watchdog.keep(self._guests)

    def _judge(self, hellos: Iterable[Hello], known: Collection[str], now: float) -> list[Effect]:
        """A `Reopen` if one of the Hellos of known agents is a reason."""
        for hello in hellos:
            if hello.sender in known and (reason := self._watchdog.reason_to_reopen(hello, now)):
                return [Reopen(reason)]
        return NO_EFFECTS
