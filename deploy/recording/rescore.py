"""Scores from a recording alone: the same scorer receives the recorded events in the same order."""

import math
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import msgspec

from deploy.recording.recording import Recording, event_of
from deploy.scoring.result import Result
from deploy.scoring.scorer import Scorer

FIGURES = (
    *("mean_ospa", "steady_ospa", "final_ospa", "mean_gospa", "steady_gospa", "final_gospa"),
    *("cardinality_error", "hole_area", "overlap_area", "share_in_view", "mass_residual"),
    *("id_switches", "idf1", "hota", "mota", "track_ospa"),
)


def rescore(recording: Recording) -> Scorer:
    """The scorer that has heard the whole recording; its `scores` and `result` are those of the run."""
    scorer = Scorer(recording.scenario, recorded=True)
    for _ in rescore_slowly(recording, scorer):
        pass
    return scorer


def rescore_slowly(recording: Recording, scorer: Scorer) -> Iterator[float]:
    """Show a recording to a scorer; gives the world's time, s, after every thing that was heard, and is finished at the end."""
    now = 0.0
    scorer.deaths.in_world_time = recording.wall_seconds is None
    faults = deque(recording.faults)
    for entry in recording.played():
        now = entry.published / 1e9
        scorer.handle(event_of(entry), now)
        while faults and scorer.truth is not None and scorer.truth.time >= faults[0].time:
            fault = faults.popleft()
            scorer.note_fault(fault.verb, fault.text, fault.who, now, fault.sides)
        yield entry.time
    scorer.finish(now)


def difference(recording: Path, result: Result) -> float | None:
    """The largest difference to the figures that the run itself wrote beside the recording; None when that was another run."""
    beside = recording.with_name("result.json")
    try:
        live = msgspec.json.decode(beside.read_bytes(), type=Result)
    except (OSError, msgspec.MsgspecError):
        return None
    if (live.transcript, live.ticks) != (result.transcript, result.ticks):
        return None
    return max(math.fabs(getattr(live, name) - getattr(result, name)) for name in FIGURES)
