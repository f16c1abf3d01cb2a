"""Presence: which agents are there, by their liveliness tokens, and what they have said of themselves."""

from collections.abc import Collection

from protocol.messages import Hello

MOST_STRANGERS = 256  # whose Hello is kept until their token comes


class Presence:
    """Agents by name; of two live incarnations of a name the newer one counts.

    Guests, which are no members, count as long as they have a token. Without one they are strangers: anybody can make up names.
    """

    def __init__(self, members: Collection[str] = ()) -> None:
        self.hellos: dict[str, Hello] = {}  # the newest of each name
        self._members = members
        self._strangers: dict[str, None] = {}  # of whom a Hello has come and no token yet, the earliest first
        self._tokens: dict[str, set[int]] = {}
        self._expected: tuple[str, ...] | None = None  # the last that `is_complete` was asked about
        self._everybody: set[str] = set()  # they, and the world
        self._unchecked: list[str] = []  # of them, the agents that have not been found ready
        self._spoken: dict[str, int] = {}  # the newest incarnation of which a message has arrived

    def appear(self, name: str, incarnation: int) -> bool:
        """Note a token; whether it made this incarnation the one that counts."""
        before = self.live(name)
        self._strangers.pop(name, None)
        self._tokens.setdefault(name, set()).add(incarnation)
        return before is None or incarnation > before

    def vanish(self, name: str, incarnation: int) -> bool:
        """Note the loss of a token; whether it was the one that counted."""
        counted = self.live(name) == incarnation
        self._tokens.get(name, set()).discard(incarnation)
        if not self._tokens.get(name):
            self._tokens.pop(name, None)
            if name not in self._members:
                self._forget(name)
        return counted

    def admits(self, name: str) -> bool:
        """Whether what this name says counts: it is a member, or has a token."""
        return name in self._members or name in self._tokens

    def _forget(self, name: str) -> None:
        for table in (self.hellos, self._spoken, self._strangers):
            table.pop(name, None)  # type: ignore[attr-defined]

    def names(self) -> set[str]:
        """Everybody who has a token, or has said a Hello that counts."""
        return {*self._tokens, *self.hellos}

    def hear(self, hello: Hello) -> bool:
        """Note a Hello; whether it is the first of its incarnation.

        Hellos of an older incarnation are ignored. Of too many strangers the earliest one is forgotten.
        """
        if not self.admits(hello.sender):
            self._strangers[hello.sender] = None
            if len(self._strangers) > MOST_STRANGERS:
                self._forget(next(iter(self._strangers)))
        known = self.hellos.get(hello.sender)
        if known is not None and known.incarnation > hello.incarnation:
            return False
        self.hellos[hello.sender] = hello
        self.note_spoken(hello.sender, hello.incarnation)
        return known is None or known.incarnation < hello.incarnation

    def note_spoken(self, name: str, incarnation: int) -> None:
        """Note that a message of this incarnation has arrived, so that it is running and listening."""
        self._spoken[name] = incarnation

    def live(self, name: str) -> int | None:
        """The incarnation that counts, None when the agent is not there."""
        tokens = self._tokens.get(name)
        return max(tokens) if tokens else None

    def speaks(self, name: str) -> bool:
        """Whether the incarnation that counts has been heard of."""
        return name in self._tokens and self._spoken.get(name) == self.live(name)

    def is_complete(self, expected: tuple[str, ...], world: str) -> bool:
        """Whether all the expected are alive, heard here, and say that they hear each other and the world; who knows its peers by
        their beacons need hear the world alone. `world` empty: a run without a world.

        It is asked with every Hello: what has been checked once is checked again when nobody is missing.
        """
        if self._unchecked:
            self._check(world)
        if not self._unchecked or expected is not self._expected:
            self._expected = expected
            self._everybody = {*expected, world} - {""}
            self._unchecked = [name for name in self._everybody if name != world]
            self._check(world)
        return not self._unchecked

    def _check(self, world: str) -> None:
        while self._unchecked and self._is_ready(self._unchecked[-1], world):
            self._unchecked.pop()

    def _is_ready(self, name: str, world: str) -> bool:
        hello = self.hellos.get(name)
        if hello is None or self.live(name) != hello.incarnation:
            return False
        return world in ("", *hello.heard) if hello.neighbours_only else self._everybody - {name} <= set(hello.heard)
