"""When an agent says Hello: to all who are new at once, and rarely otherwise, for everybody's greetings go to everybody.

While a swarm starts its members come one by one, and a greeting for each of them would be N^2 greetings to N listeners. Until the run is
known to be going on, the rhythm does, and the news count once the whole team is there.
"""

from collections.abc import Callable

SOON = 0.05  # s between the appearance of somebody new and a greeting
CROWD = 12  # peers from which on greetings become rarer
THRONG = 24  # and from which on the moment becomes longer, for the greetings of all have to come through
EARLY, LATE = 0.25, 2.0  # s between greetings while somebody is unknown or nothing has been observed, and later
LATEST = 4.0  # s between greetings in a crowd; a second below `presence.PATIENCE`, for which what a greeting says of others holds
MANY = 48  # peers from which on the later rhythm slows down too


class AnnouncementSchedule:
    """The next greeting of one agent; times are `now` of its node, s."""

    def __init__(self, team: int, is_complete: Callable[[], bool]) -> None:
        """`team`: how many others are expected; `is_complete`: whether they are all there."""
        self.due: float | None = None
        self._team, self._is_complete = team, is_complete
        self._run_started = False

    def start(self, now: float) -> None:
        """I have just greeted for the first time."""
        self.due = now + self._early(0)

    def peer_appeared(self, peers: int, now: float) -> None:
        """Somebody is new, who makes it so many peers: greet, but once for all who appear within a moment."""
        if self._run_started or self._is_complete():
            soon = now + SOON * max(1.0, peers / THRONG)
            self.due = soon if self.due is None else min(self.due, soon)

    def run_started(self) -> None:
        """The run goes on, with or without me: from now on whoever is new is greeted soon."""
        self._run_started = True

    def observation_arrived(self, now: float) -> None:
        """An observation has come."""
        self.run_started()
        if self.due is not None:
            self.due = min(self.due, now + LATEST)  # later only if the clock has jumped back

    def is_due(self, peers: int, early: bool, now: float) -> bool:
        """Whether to greet now; if so the next greeting is planned. `early`: somebody is unknown, or nothing has been observed."""
        if self.due is None or now < self.due:
            return False
        late = min(LATE * max(1.0, peers / MANY), LATEST)
        self.due = now + (self._early(peers) if early else late)
        return True

    def _early(self, peers: int) -> float:
        return min(EARLY * crowd(max(peers, self._team)), LATE)


def crowd(peers: int) -> float:
    """How much rarer greetings are among so many peers."""
    return max(1.0, peers / CROWD)
