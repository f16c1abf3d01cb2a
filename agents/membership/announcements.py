"""When an agent sends Hello: soon after a new peer appears, and rarely otherwise, because every Hello goes to every agent.

While a swarm starts, its members appear one by one. A Hello for each of them would be N^2 messages to N listeners. Until the run has
started, Hellos therefore follow a fixed rhythm. A new peer causes a Hello at once only when the run has started or the whole roster is
alive.
"""

from collections.abc import Callable

REPLY_DELAY = 0.05  # s between the appearance of a new peer and a Hello
EARLY_CROWD = 12  # above this number of peers early Hellos become rarer
REPLY_CROWD = 24  # above this number of peers `REPLY_DELAY` grows with it, so that the Hellos of all get through
EARLY_PERIOD, LATER_PERIOD = 0.25, 2.0  # s between Hellos: while a sensor is unknown or nothing has been observed, and later
# s between Hellos in a large swarm; a second below `session_watchdog.LISTED_LATELY`, for which the names in a Hello hold
LONGEST_PERIOD = 4.0
LATER_CROWD = 48  # above this number of peers the later rhythm slows down as well


class AnnouncementSchedule:
    """The schedule of one agent's Hellos; times are `now` of its node, s."""

    def __init__(self, team: int, is_complete: Callable[[], bool]) -> None:
        """`team`: the number of other agents that are expected; `is_complete`: whether all of them are alive."""
        self.due: float | None = None
        self._team, self._is_complete = team, is_complete
        self._run_started = False

    def start(self, now: float) -> None:
        """The agent has just sent its first Hello."""
        self.due = now + self._early_period(0)

    def peer_appeared(self, peers: int, now: float) -> None:
        """A new peer makes the number of peers `peers`: plan one Hello for all that appear within a moment."""
        if self._run_started or self._is_complete():
            soon = now + REPLY_DELAY * max(1.0, peers / REPLY_CROWD)
            self.due = soon if self.due is None else min(self.due, soon)

    def run_started(self) -> None:
        """The run has started: from now on a new peer gets a Hello soon."""
        self._run_started = True

    def observation_arrived(self, now: float) -> None:
        """An observation has arrived."""
        self.run_started()
        if self.due is not None:
            self.due = min(self.due, now + LONGEST_PERIOD)  # `due` lies later only if the clock has jumped back

    def take_due(self, peers: int, early: bool, now: float) -> bool:
        """Whether a Hello is due now; then the next one is planned. `early`: a sensor is unknown, or nothing has been observed."""
        if self.due is None or now < self.due:
            return False
        late = min(LATER_PERIOD * max(1.0, peers / LATER_CROWD), LONGEST_PERIOD)
        self.due = now + (self._early_period(peers) if early else late)
        return True

    def _early_period(self, peers: int) -> float:
        """Time between Hellos before the run has started or while a sensor is unknown, s."""
        return min(EARLY_PERIOD * max(1.0, max(peers, self._team) / EARLY_CROWD), LATER_PERIOD)
