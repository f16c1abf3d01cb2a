"""Whether the session of a bridge is half open (docs/reference/protocol.md, *Liveliness tokens*; zenoh issue 2806).

After an outage a session can be left through which nothing of a peer comes, or no tokens. The Hellos of the others tell it from a death.
"""

from collections.abc import Iterable
from typing import Any

from deploy.bridge.client import Heard

HEARD_LATELY = 3.0  # s since the last message
LISTED_LATELY = 5.0  # s since the last Hello that listed a name
PATIENCE = 5.0  # s for which a sign must last, at least; the lease of the links, if that is longer
FIRST_REST, LONGEST_REST = 20.0, 320.0  # s between two alarms, doubled each time
MOST_GUESTS = 4096  # agents with a token that are not expected: anybody can make up names

NEVER = -float("inf")


class BridgeWatchdog:
    """What the Hellos of the agents say about the own session. Others than the expected agents count once they have a token."""

    def __init__(self, expected: Iterable[str], lease: float) -> None:
        """`lease`: s for which a link may be silent."""
        self._expected, self._patience = frozenset(expected), max(PATIENCE, lease)
        self._guests: dict[str, None] = {}  # other agents that had a token, the earliest first
        self._words: dict[str, float] = {}  # name -> when its last message came
        self._hellos: dict[str, tuple[frozenset[str], float]] = {}  # name -> whom its last Hello lists, and when it came
        self._tokens: dict[str, set[int]] = {}  # name -> incarnations with a token
        self._missed: dict[str, float] = {}  # name -> since when the others hear it and this session does not
        self._tokenless: dict[str, float] = {}  # name -> when its first Hello without a token came
        self._rest, self._not_before = FIRST_REST, NEVER

    def take(self, heard: Heard, now: float) -> str:
        """Take a message or a token; the reason to open the session anew, empty if there is none."""
        if heard.kind == "agent":
            self._take_token(heard)
        elif heard.kind in ("gossip", "hello") and self._counts(heard.name):
            self._words[heard.name] = now
            if heard.kind == "hello":
                self._hellos[heard.name] = frozenset(name for name in heard.fields.get("heard", ()) if isinstance(name, str)), now
                return self._judge(heard.name, now)
        return ""

    def _take_token(self, heard: Heard) -> None:
        """Note a token of an agent that came or went."""
        if heard.up and heard.name not in self._expected:
            self._guests[heard.name] = None
            if len(self._guests) > MOST_GUESTS:
                self._forget(next(iter(self._guests)))
        if not self._counts(heard.name):
            return
        tokens = self._tokens.setdefault(heard.name, set())
        (tokens.add if heard.up else tokens.discard)(heard.incarnation)
        (self._words if not tokens else self._tokenless).pop(heard.name, None)

    def _counts(self, name: str) -> bool:
        """Whether a name is that of an expected agent, or has had a token."""
        return name in self._expected or name in self._guests

    def _forget(self, name: str) -> None:
        tables: tuple[dict[str, Any], ...] = self._guests, self._words, self._hellos, self._tokens, self._missed, self._tokenless
        for table in tables:
            table.pop(name, None)

    def _judge(self, sender: str, now: float) -> str:
        """The first sign that has lasted, upon a Hello."""
        if self._tokens.get(sender) == set():
            self._tokenless.setdefault(sender, now)
        voters = [listed for voter, (listed, when) in self._hellos.items() if self._is_heard(voter, now) and now - when <= LISTED_LATELY]
        missed = [name for name in sorted(frozenset().union(*voters)) if self._counts(name) and self._is_missed(name, voters, now)]
        self._missed = {name: self._missed.get(name, now) for name in missed}
        signs = [(since, f"the others hear {name}, this session does not") for name, since in self._missed.items()]
        if sender in self._tokenless:
            signs.append((self._tokenless[sender], f"{sender} speaks, but its token has gone"))
        lasting = [sign for since, sign in signs if now - since >= self._patience]
        if not lasting or now < self._not_before:
            return ""
        self._not_before, self._rest = now + self._rest, min(2.0 * self._rest, LONGEST_REST)
        self._missed.clear()
        self._tokenless.clear()
        return lasting[0]

    def _is_missed(self, name: str, voters: list[frozenset[str]], now: float) -> bool:
        """Whether nothing comes of a name that at least half of the heard agents list."""
        return not self._is_heard(name, now) and 2 * sum(name in listed for listed in voters) >= len(voters)

    def _is_heard(self, name: str, now: float) -> bool:
        return now - self._words.get(name, NEVER) <= HEARD_LATELY
