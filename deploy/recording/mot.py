"""A recording in the form of the MOT challenge: a folder with the truth, the estimates, and what the sequence is called.

Rules. A row is frame, id, left, top, width, height, confidence, x, y, z, as in MOT15. Frames count from 1. A target is a square of side
`SIDES` x `study.cutoff` m around its place, so that boxes of a target and of an estimate farther away than about two thirds of the
cut-off do not overlap by half. The top of the picture is north. The last three columns are the place in m. Estimates without a label go
into det/det.txt with the id -1, as detections do; estimates with labels go into res/res.txt as well. Ids count the labels, and the true
targets, from 1 in the order in which they appear, because readers of these files make tables as long as the largest id. Every frame holds
the estimates that the scorer counts in its tick: an agent whose estimate of the tick is missing has its last one there, moved on by its
velocity. A label counts once in a frame (deploy/scoring/tracks.py).
"""

from collections.abc import Iterable
from pathlib import Path

from deploy.recording.recording import Recording
from deploy.recording.rescore import rescore
from deploy.scenario import Scenario
from protocol.whole_file import write_whole

SIDES = 2.0
UNKNOWN = -1


def write_mot(recording: Recording, folder: Path) -> list[Path]:
    """The files, in a folder that is made."""
    scenario, truth, found, labelled = recording.scenario, [], [], []
    scorer, targets, numbers, frame = rescore(recording), dict[int, int](), dict[int, int](), 0
    for score, tick, has_label in zip(scorer.scores, scorer.tracks.ticks, scorer.tracks.labelled):
        frame = score.tick + 1
        for name, (x, y) in zip(tick.ids.tolist(), tick.targets.tolist()):
            truth.append(_row(scenario, frame, targets.setdefault(name, len(targets) + 1), x, y))
        found += [_row(scenario, frame, UNKNOWN, x, y) for x, y in tick.estimates.tolist()]
        for label, (x, y) in zip(tick.labels[has_label].tolist(), tick.estimates[has_label].tolist()):
            labelled.append(_row(scenario, frame, numbers.setdefault(label, len(numbers) + 1), x, y))
    rows = {"gt": truth, "det": found, "res": labelled}
    files = [_written(folder / name / f"{name}.txt", lines) for name, lines in rows.items()]
    return [*files, _written(folder / "seqinfo.ini", _about(recording, frame))]


def _row(scenario: Scenario, frame: int, name: int, x: float, y: float) -> str:
    side = SIDES * scenario.study.cutoff
    left, top = x - side / 2.0, scenario.arena.height - y - side / 2.0
    return f"{frame},{name},{left:.6f},{top:.6f},{side:.6f},{side:.6f},1,{x:.6f},{y:.6f},0"


def _about(recording: Recording, frames: int) -> list[str]:
    scenario = recording.scenario
    return [
        "[Sequence]",
        f"name={recording.run}",
        f"frameRate={1.0 / scenario.run.dt:g}",
        f"seqLength={frames}",
        f"imWidth={scenario.arena.width:g}",
        f"imHeight={scenario.arena.height:g}",
    ]


def _written(file: Path, lines: Iterable[str]) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, "".join(f"{line}\n" for line in lines).encode())
    return file
