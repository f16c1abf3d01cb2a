"""Local health: how late one agent is served, measured by the agent itself (the idea of Lifeguard).

An agent that is starved of CPU time, or that was stopped, hears nothing for a while although its peers speak. Its own time-outs then say
nothing about them. The agent plans a beat every `BEAT_PERIOD` s. A beat that comes late shows for how long the agent was not served, by
`now` alone: the core needs no clock for it. In lockstep the world waits, no time-out decides anything, and no beat is planned.
"""

BEAT_PERIOD = 0.25  # s between two beats
STALL_THRESHOLD = 0.25  # s: a beat that is later than this is a stall
SUSPICION_SECONDS = 3.0  # s after a stall in which a lost token is only a suspicion: sessions that ended meanwhile are noticed by then


class LocalHealth:
    """The lateness of one agent. Times are `now` of its node, s. A clock that jumps forward makes it careful for a moment."""

    def __init__(self, *, measured: bool) -> None:
        """`measured` false: no beat is planned, and the agent counts as served in time."""
        self.due: float | None = None  # the next beat; None: none is planned
        self.stalled = 0.0  # s for which the agent was not served, in all
        self._measured = measured
        self._stall_ended: float | None = None

    def start(self, now: float) -> None:
        """Plan the first beat."""
        self.due = now + BEAT_PERIOD if self._measured else None

    @property
    def is_measuring(self) -> bool:
        """Whether beats are planned: in real time, from the first observation on."""
        return self.due is not None

    def note_event(self, now: float) -> bool:
        """Note that the agent takes an event; whether a stall has just ended."""
        if self.due is None:
            return False
        if now < self.due:
            self.due = min(self.due, now + BEAT_PERIOD)  # later only after a clock has jumped back
            return False
        late, self.due = now - self.due, now + BEAT_PERIOD
        if late <= STALL_THRESHOLD:
            return False
        self.stalled += late
        self._stall_ended = now
        return True

    def has_just_stalled(self, now: float) -> bool:
        """Whether the agent was stalled a short time ago."""
        return self._stall_ended is not None and abs(now - self._stall_ended) <= SUSPICION_SECONDS

    def has_stalled_since(self, since: float) -> bool:
        """Whether a stall has ended since a time."""
        return self._stall_ended is not None and self._stall_ended > since
