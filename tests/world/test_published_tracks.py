"""Scores of tracks on the files and examples of others: those that motmetrics ships and tests itself with, read by TrackEval too.

The pedestrians of TUD-Campus and TUD-Stadtmitte (Andriluka, Roth and Schiele, CVPR 2008) with a tracker's result lie in the package
motmetrics (C. Heindl, J. Valmadre and others, MIT licence). Nothing is downloaded.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from world.track_score import Compared, score_of

FRAMES = {"TUD-Campus": 71, "TUD-Stadtmitte": 179}
Frame = tuple[list[int], list[int], list[list[float]]]
NOTHING: list[list[float]] = []


def folder(sequence: str) -> Path:
    """Where motmetrics keeps a sequence: gt.txt and test.txt, rows of frame, id, left, top, width, height and more."""
    return Path(pytest.importorskip("motmetrics").__file__).parent / "data" / sequence


def overlaps(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The intersections over the unions (T, M) of boxes (T, 4) and others (M, 4): left, top, width, height."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum((boxes[:, :2] + boxes[:, 2:])[:, None], (others[:, :2] + others[:, 2:])[None])
    shared = np.maximum(high - low, 0.0).prod(axis=2)
    return shared / (boxes[:, 2:].prod(axis=1)[:, None] + others[:, 2:].prod(axis=1)[None] - shared)  # type: ignore[no-any-return]


def ticks_of(sequence: str) -> list[Compared]:
    """The frames of a sequence, from 1."""
    true, found = (np.loadtxt(folder(sequence) / name, delimiter=",") for name in ("gt.txt", "test.txt"))
    ticks = []
    for frame in range(1, FRAMES[sequence] + 1):
        here, there = true[true[:, 0] == frame], found[found[:, 0] == frame]
        ticks.append(Compared(here[:, 1], there[:, 1], overlaps(here[:, 2:6], there[:, 2:6])))
    return ticks


@pytest.mark.parametrize(("sequence", "idf1", "mota"), [("TUD-Campus", 0.557659, 0.526462), ("TUD-Stadtmitte", 0.644619, 0.564014)])
def test_the_numbers_that_motmetrics_publishes_come_out_of_its_own_files(sequence: str, idf1: float, mota: float) -> None:
    """They stand with six digits in its unit test `test_motchallenge_files`, with seven switches for both sequences."""
    found = score_of(ticks_of(sequence))
    assert (found.id_switches, round(found.idf1, 6), round(found.mota, 6)) == (7, idf1, mota)


@pytest.mark.parametrize("sequence", FRAMES)
def test_motmetrics_computes_the_same_from_these_overlaps(sequence: str) -> None:
    motmetrics = pytest.importorskip("motmetrics")
    scored = motmetrics.MOTAccumulator(auto_id=True)  # its own overlaps need a numpy before 2
    for ids, labels, similar in ticks_of(sequence):
        scored.update(ids, labels, np.where(similar >= 0.5, 1.0 - similar, np.nan))
    theirs = motmetrics.metrics.create().compute(scored, metrics=["num_switches", "idf1", "mota"]).iloc[0]
    ours = score_of(ticks_of(sequence))
    assert ours.id_switches == theirs["num_switches"]
    assert (ours.idf1, ours.mota) == pytest.approx((theirs["idf1"], theirs["mota"]), abs=1e-9)


@pytest.mark.parametrize("sequence", FRAMES)
def test_trackeval_computes_the_same_from_these_files_read_by_itself(sequence: str, tmp_path: Path) -> None:
    trackeval = pytest.importorskip("trackeval")
    truth, found = tmp_path / "gt" / "MOT15-train" / sequence, tmp_path / "trackers" / "MOT15-train" / "theirs" / "data"
    (truth / "gt").mkdir(parents=True)
    found.mkdir(parents=True)
    (truth / "seqinfo.ini").write_text(f"[Sequence]\nname={sequence}\nseqLength={FRAMES[sequence]}\n")
    (truth / "gt" / "gt.txt").write_text((folder(sequence) / "gt.txt").read_text())
    (found / f"{sequence}.txt").write_text((folder(sequence) / "test.txt").read_text())
    options: dict[str, Any] = {"BENCHMARK": "MOT15", "SPLIT_TO_EVAL": "train", "SEQ_INFO": {sequence: None}, "PRINT_CONFIG": False}
    options |= {"GT_FOLDER": str(tmp_path / "gt"), "TRACKERS_FOLDER": str(tmp_path / "trackers"), "DO_PREPROC": False}
    files = trackeval.datasets.MotChallenge2DBox(options)
    data = files.get_preprocessed_seq_data(files.get_raw_seq_data("theirs", sequence), "pedestrian")
    quiet = {"PRINT_CONFIG": False}
    clear = trackeval.metrics.CLEAR(quiet).eval_sequence(data)
    identity = trackeval.metrics.Identity(quiet).eval_sequence(data)
    hota = float(np.mean(trackeval.metrics.HOTA().eval_sequence(data)["HOTA"]))
    ours = score_of(ticks_of(sequence))
    assert ours.id_switches == clear["IDSW"]
    assert (ours.mota, ours.idf1, ours.hota) == pytest.approx((clear["MOTA"], identity["IDF1"], hota), abs=1e-9)


def compared(ids: list[int], labels: list[int], apart: list[list[float]]) -> Compared:
    """A frame of an example by distances (T, M); not a number: never a match. Up to 10 is one, as the examples have no limit."""
    distances = np.array(apart, dtype=float).reshape(len(ids), len(labels))
    return Compared(np.array(ids), np.array(labels), np.where(np.isnan(distances), 0.0, 1.0 - np.nan_to_num(distances) / 20.0))


def test_the_examples_in_the_unit_tests_of_motmetrics_come_out() -> None:
    """`test_mota_motp`: two false, two missed, two switches among eight targets. `test_ids`: three switches among ten."""
    none = float("nan")
    first: list[Frame] = [([], [1, 2], NOTHING), ([1, 2], [], NOTHING), ([1, 2], [1, 2], [[1, 0.5], [0.3, 1]])]
    first += [([1, 2], [1, 2], [[0.2, none], [none, 0.1]]), ([1, 2], [1, 2], [[5, 1], [1, 5]]), ([], [], NOTHING)]
    found = score_of([compared(*frame) for frame in first])
    assert (found.id_switches, found.mota) == (2, pytest.approx(1.0 - 6.0 / 8.0, abs=1e-9))
    second: list[Frame] = [([], [], NOTHING), ([1, 2], [1, 2], [[1, 0], [0, 1]]), ([1, 2], [1, 2], [[0.4, none], [none, 0.4]])]
    second += [([1, 2], [1, 2], [[0, 1], [1, 0]]), ([1, 2], [2, 3], [[1, 0], [0.4, 0.7]]), ([1, 3], [2, 3], [[1, 0], [0.4, 0.7]])]
    found = score_of([compared(*frame) for frame in second])
    assert (found.id_switches, found.mota) == (3, pytest.approx(1.0 - 3.0 / 10.0, abs=1e-9))
