"""Who is within my hearing, and whom others hear though I do not: the sign of a session that has stayed split.

Two Zenoh peers that lose each other and come back can be left with half a session, through which one or both hear nothing for ever
(zenoh issue 2806). Nobody can tell this from a death by himself; the others can: their Hellos list whom they hear. When most of those
whom I hear go on listing somebody of whom I have heard nothing for long, my session is to be opened anew. So it is when somebody whose
token has gone goes on speaking: through half a session words may come, but no token does any more.
"""

from collections.abc import Iterable

from protocol.messages import Hello

WITHIN_HEARING = 3.0  # s since the last word; everybody says Hello every 2 s
PATIENCE = 5.0  # s for which others say otherwise before the session is opened anew
FIRST_REST, LONGEST_REST = 20.0, 320.0  # s between two openings, doubled each time: nobody shall be kept busy by a false Hello

NEVER = -float("inf")


class FailureDetector:
    """Whose words arrive at one node. Times are `now` of that node, s; a clock that jumps delays an alarm, it raises none."""

    def __init__(self, name: str, expected: Iterable[str]) -> None:
        """`expected`: names that count when others claim to hear them."""
        self._name, self._expected = name, tuple(expected)
        self._words: dict[str, float] = {}  # when the last word of each came
        self._up: dict[str, int] = {}  # the youngest incarnation whose token has been seen
        self._lost: dict[str, float | None] = {}  # whose token has gone -> since when Hellos of it come all the same
        self._greeted: set[str] = set()  # whose Hello has come
        self._claims: dict[str, dict[str, float]] = {}  # silent name -> who claims to hear it, and when that was last said
        self._since: dict[str, float] = {}  # silent name -> since when somebody has been claiming so
        self._voters: set[str] = set()  # whose Hellos `split` has been shown
        self._rest, self._not_before = FIRST_REST, NEVER
        self._calm_until = NEVER  # so long nobody can be out of hearing, whatever is said of it

    def speak(self, name: str, now: float) -> None:
        """A message of somebody has come."""
        self._words[name] = now

    def speak_all(self, names: Iterable[str], now: float) -> None:
        """Messages of several have come."""
        self._words.update(dict.fromkeys(names, now))

    def greet(self, name: str, now: float) -> bool:
        """A Hello of somebody has come; whether it is the first."""
        self._words[name] = now
        first = name not in self._greeted
        self._greeted.add(name)
        return first

    def greet_again(self, name: str, now: float) -> bool:
        """A Hello of somebody has come; whether that is no news, and `split` could find nothing in it. Else it is as if it had not come."""
        if now > self._calm_until or self._lost or name not in self._greeted:
            return False
        self._words[name] = now
        self._voters.add(name)
        return True

    def appear(self, name: str, incarnation: int) -> None:
        """The token of somebody has been seen."""
        self._up[name] = max(incarnation, self._up.get(name, 0))
        self._lost.pop(name, None)

    def leave(self, name: str, incarnation: int) -> None:
        """The token of somebody has vanished: out of hearing until the next word."""
        self._words.pop(name, None)
        self._calm_until = NEVER
        if incarnation >= self._up.get(name, 0):  # not the late end of one who has come back since
            self._lost[name] = None

    def heard(self, now: float | None = None) -> tuple[str, ...]:
        """Names for my Hello: who has greeted me, has not left, and has spoken lately; `now` None: however long ago."""
        words, greeted = self._words, self._greeted
        if now is None:
            return tuple(sorted([name for name in greeted if name in words]))
        return tuple(sorted([name for name in greeted if now - words.get(name, NEVER) <= WITHIN_HEARING]))

    def split(self, hello: Hello, now: float) -> str:
        """Take a peer's Hello: why my session must be split, if that has gone on for too long; else empty."""
        alarm = self._wordy(hello.sender, now) or self._silent(hello, now)
        if alarm:
            self._claims.clear()
            self._since.clear()
            self._lost.clear()
            self._not_before, self._rest = now + self._rest, min(2.0 * self._rest, LONGEST_REST)
        return alarm

    def _wordy(self, name: str, now: float) -> str:
        """Whether somebody goes on greeting though its token has gone."""
        if name not in self._lost:
            return ""
        since = self._lost[name]
        if since is None or since > now:
            since = self._lost[name] = now
        late = now - since >= PATIENCE and now >= self._not_before
        return f"{name} speaks, but its token has gone" if late else ""

    def _silent(self, hello: Hello, now: float) -> str:
        """Whether there is somebody of whom I hear nothing though most of my peers do."""
        alarm = ""
        self._voters.add(hello.sender)
        if now <= self._calm_until:
            return alarm
        words, known = self._words, (self._name, hello.sender)
        silent = [name for name in self._expected if not now - words.get(name, NEVER) <= WITHIN_HEARING and name not in known]
        for name in self._since.keys() - silent:
            del self._claims[name], self._since[name]
        spoken_of = self._since.keys() | hello.heard  # while a swarm gathers most are silent, and nobody has heard them yet
        for name in silent:
            if name in spoken_of and self._is_split(name, hello, now):
                alarm = f"the others hear {name}, {self._name} does not"
        if not silent and not self._since:
            self._calm_until = min([words[name] for name in self._expected if name not in known], default=now) + WITHIN_HEARING
        return alarm

    def _is_split(self, name: str, hello: Hello, now: float) -> bool:
        """Note what a peer says of somebody of whom I hear nothing; whether that is enough."""
        claims = {other: when for other, when in self._claims.get(name, {}).items() if now - when <= PATIENCE}
        if not claims:
            self._since[name] = now  # nobody has been saying so
        if name in hello.heard:
            claims[hello.sender] = now
        else:
            claims.pop(hello.sender, None)
        self._claims[name] = claims
        if not claims:
            del self._claims[name], self._since[name]
            return False
        if now - self._since[name] < PATIENCE or now < self._not_before:
            return False
        voters = sum(self._hears(other, now) for other in self._voters if other != name)
        return 2 * len(claims) >= voters

    def _hears(self, name: str, now: float) -> bool:
        return name in self._words and now - self._words[name] <= WITHIN_HEARING
