"""The result of a run: one record, one JSON object, one table."""

import json
from typing import NamedTuple

import msgspec

from deploy.installation import VERSION
from deploy.scoring.status import TickRate


class Fault(NamedTuple):
    """An ordered fault that no message shows."""

    time: float  # of the world, s
    verb: str
    text: str
    who: str = ""  # names of the affected agents, with commas
    sides: int = 1  # into which cuts divide the living agents, once it is carried out


class EventReport(NamedTuple):
    """A sentence about the effect of an event."""

    time: float  # of the world at the report, s
    who: str
    text: str


class Tally(msgspec.Struct):
    """Counts over the run."""

    messages: int = 0
    bytes: int = 0
    rejected: int = 0
    residual: float = 0.0  # the largest difference between the mass that an agent reports and that of its particles


class Kill(msgspec.Struct, frozen=True, kw_only=True):
    """The death of an agent, and how long the others took to cover its former cell but for one per cent."""

    name: str
    tick: int  # the newest when it went
    time: float  # of the world, s
    closed_seconds: float | None  # wall s, or world s in a simulation; None: the run ended before, or the agent was back before
    closed_ticks: int | None


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a run. Lengths in m, areas as shares of the arena, times in s."""

    scenario: str
    seed: int
    partition: str
    capacity: str
    control: str
    agents: int  # members of the scenario
    missing: tuple[str, ...] = ()  # those of them that were not there at the first tick
    ticks: int  # that were scored
    dt: float
    wall_s: float | None  # of the clock; None: the recording of a simulation does not know
    mean_ospa: float
    steady_ospa: float  # last `study.steady_share` of the run
    final_ospa: float
    mean_gospa: float
    steady_gospa: float
    final_gospa: float
    cardinality_error: float  # mean over the steady part of |sum of masses - number of targets|
    share_in_view: float  # of target-time
    targets: int  # at the end
    targets_in_view: int  # at the end
    hole_area: float  # the largest, share of the arena
    overlap_area: float
    mass_residual: float  # the largest difference between the mass an agent says and that of its particles or Gaussians, expected targets
    messages: int
    bytes: int
    rounds: int  # played by all agents together
    kills: tuple[Kill, ...]
    transcript: str  # hash of all poses, and of estimates with their labels
    version: str = VERSION
    steady_localisation: float = 0.0  # the parts of GOSPA, m
    steady_missed: float = 0.0
    steady_false: float = 0.0
    steady_targets: float = 0.0  # number of targets; of those that the agents report; of those that they expect
    steady_estimated: float = 0.0
    steady_mass: float = 0.0
    steady_coverage: float = 0.0  # share of the arena inside some footprint
    end_in_view: float = 0.0  # share of target-time over the last 5 s
    id_switches: int = 0  # of identities; these four as in TrackEval, with the similarity 1 - distance / cut-off
    idf1: float = 0.0
    hota: float = 0.0
    mota: float = 0.0
    track_ospa: float = 0.0  # OSPA(2), m, mean over windows of 10 s
    events: tuple[EventReport, ...] = ()  # the effect of each death, return and cut
    has_targets: bool = True  # false: the scenario has none, and all that compares with true targets says nothing
    tick_rate: TickRate | None = None  # of a run with processes: ticks a second, rounds that were skipped or late
    exit_code: int = 0  # of the run: 0 done, 1 a process failed, 130 and 143 stopped by a signal

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(msgspec.to_builtins(self))

    def rows(self) -> list[tuple[str, str]]:
        """The table for people: rows of a label and a value."""
        if not self.ticks:
            return [("ended before the first tick", "nothing was measured")]
        closed = [kill for kill in self.kills if kill.closed_seconds is not None]
        slowest = max(closed, key=lambda kill: kill.closed_seconds or 0.0, default=None)
        hole = "not closed" if self.kills else "-"
        if slowest is not None:
            hole = f"{slowest.closed_seconds:.2f} s, {slowest.closed_ticks} tick{'s' * (slowest.closed_ticks != 1)}"
        if slowest is not None and len(closed) < len(self.kills):
            hole += f" ({len(self.kills) - len(closed)} not closed)"
        names = ", ".join(kill.name for kill in self.kills)
        missing = [("missing from the start", f"{len(self.missing)} of {self.agents}: {', '.join(self.missing)}")] if self.missing else []
        none = [] if self.has_targets else [("no scores", "targets.count = 0: no true targets are known")]

        def compared(figures: str) -> str:
            return figures if self.has_targets else "-"

        return [
            *missing,
            *none,
            ("OSPA, mean / steady / final", compared(f"{self.mean_ospa:.2f} / {self.steady_ospa:.2f} / {self.final_ospa:.2f} m")),
            ("GOSPA, mean / steady / final", compared(f"{self.mean_gospa:.1f} / {self.steady_gospa:.1f} / {self.final_gospa:.1f} m")),
            (
                "  localisation + missed + false",
                compared(f"{self.steady_localisation:.1f} + {self.steady_missed:.1f} + {self.steady_false:.1f} m"),
            ),
            (
                "targets / reported / expected",
                f"{compared(f'{self.steady_targets:.1f}')} / {self.steady_estimated:.1f} / {self.steady_mass:.1f}",
            ),
            ("identity switches, IDF1 / HOTA / MOTA", compared(f"{self.id_switches}, {self.idf1:.2f} / {self.hota:.2f} / {self.mota:.2f}")),
            ("OSPA of tracks", compared(f"{self.track_ospa:.2f} m")),
            ("arena in view", f"{100.0 * self.steady_coverage:.0f} %"),
            (
                "targets in view at the end",
                compared(f"{self.targets_in_view} of {self.targets} ({100.0 * self.share_in_view:.0f} % of the time)"),
            ),
            ("ticks / rounds of all agents", f"{self.ticks} / {self.rounds}"),
            ("messages", f"{self.messages} ({self.bytes / 1e6:.1f} MB)"),
            ("killed", f"{len(self.kills)} of {self.agents}" + (f": {names}" if names else "")),
            ("time to close the hole", hole),
            ("largest hole / overlap", f"{100.0 * self.hole_area:.2f} / {100.0 * self.overlap_area:.2f} % of the arena"),
            ("wall time", "-" if self.wall_s is None else f"{self.wall_s:.1f} s"),
            *(_tick_rate_rows(self.tick_rate) if self.tick_rate is not None else []),
        ]


def _tick_rate_rows(tick_rate: TickRate) -> list[tuple[str, str]]:
    spared = [("ticks played alone", str(tick_rate.spared))] if tick_rate.spared else []
    stalled = [("agents that were stalled", f"{len(tick_rate.stalled)}: {', '.join(tick_rate.stalled)}")] if tick_rate.stalled else []
    done = "-" if tick_rate.ticks_per_s is None else f"{tick_rate.ticks_per_s:.1f}"
    asked = "as fast as it goes" if tick_rate.asked_per_s is None else f"asked {tick_rate.asked_per_s:g}"
    return [
        ("ticks a second", f"{done} ({asked})"),
        ("rounds skipped / late", f"{tick_rate.skipped} / {tick_rate.late} of {tick_rate.rounds}"),
        *spared,
        *stalled,
    ]
