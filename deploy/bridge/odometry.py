"""Where a robot was lately, by its odometry, so that a scan is placed where the robot was when it was taken.

Stamps are those of ROS headers, ns, by the clocks of the robot alone. Only their differences count: nothing here reads a clock.
A *twist* is a velocity ahead and to the left, m/s, and a turn rate, rad/s, in the robot's own frame.
"""

import math
from bisect import bisect_right
from collections import deque

from deploy.bridge.frames import Placement, placed

KEPT = 1_000_000_000  # ns before the newest odometry
MOST = 2000  # poses at most, whatever the stamps say
AHEAD = 200_000_000  # ns that a scan may be ahead of the newest odometry where both have one clock
STILL = 0.0, 0.0, 0.0


class Odometry:
    """The poses of about a second."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, Placement]] = deque(maxlen=MOST)  # by ascending stamp
        self._twist: Placement = STILL  # of the newest

    @property
    def newest(self) -> Placement:
        """The pose that was said last; the origin before."""
        return self._kept[-1][1] if self._kept else (0.0, 0.0, 0.0)

    @property
    def stamp(self) -> int:
        """The stamp of the newest pose, ns; 0: there is none."""
        return self._kept[-1][0] if self._kept else 0

    def note(self, stamp: int, pose: Placement, twist: Placement = STILL) -> None:
        """Keep a pose of this stamp, ns. Kept poses of this stamp or a later one go: the clock was set back, or there are no stamps."""
        self._twist = twist if all(map(math.isfinite, twist)) else STILL
        while self._kept and self._kept[-1][0] >= stamp:
            self._kept.pop()
        self._kept.append((stamp, pose))
        while self._kept[0][0] < stamp - KEPT:
            self._kept.popleft()

    def spans(self, stamp: int) -> bool:
        """Whether a stamp, ns, is not set (0), or lies in the second that is kept or a moment ahead of it."""
        return stamp == 0 or self.stamp - KEPT <= stamp <= self.stamp + AHEAD

    def at(self, stamp: int) -> Placement:
        """The pose at this stamp, ns, between the two around it, the heading on the shortest way.

        A stamp that is ahead of all by at most `AHEAD` gives the newest pose, moved on by its twist. One that is farther ahead is of
        another clock, and one of 0 is not set: both give the newest pose. One that is older than all that are kept gives the oldest.
        """
        after = bisect_right(self._kept, stamp, key=lambda kept: kept[0])
        if not stamp or after == len(self._kept):
            seconds = (stamp - self.stamp) / 1e9 if 0 < stamp - self.stamp <= AHEAD else 0.0
            ahead, left, turn = self._twist
            return placed(self.newest, (seconds * ahead, seconds * left, seconds * turn))
        if after == 0:
            return self._kept[0][1]
        (began, (x, y, heading)), (ended, (to_x, to_y, to_heading)) = self._kept[after - 1], self._kept[after]
        share = (stamp - began) / (ended - began)
        turn = math.remainder(to_heading - heading, 2.0 * math.pi)
        return x + share * (to_x - x), y + share * (to_y - y), math.remainder(heading + share * turn, 2.0 * math.pi)
