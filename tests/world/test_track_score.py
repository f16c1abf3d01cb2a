"""Scores of tracks: numbers by hand, and those of TrackEval and motmetrics on random tracks."""

import numpy as np
import pytest

from world.track_score import TrackTick, similarity, track_ospa, track_score


def ticks_of(rows: list[tuple[list[int], list[float], list[int], list[float]]]) -> list[TrackTick]:
    """Ticks on a line: ids and x of targets, labels and x of estimates."""

    def places(xs: list[float]) -> np.ndarray:
        return np.array([(x, 0.0) for x in xs]).reshape(-1, 2)

    return [TrackTick(np.array(ids), places(xs), np.array(labels), places(ys)) for ids, xs, labels, ys in rows]


def test_a_track_that_changes_its_name_once_has_one_switch() -> None:
    """Of four matches two belong to each label, so IDF1 is 4 / 8. HOTA is the root of the mean of 2 / 4 over the matches."""
    found = track_score(ticks_of([([7], [1.0], [label], [1.0]) for label in (3, 3, 4, 4)]), 10.0)
    assert (found.id_switches, found.idf1, found.mota) == (1, 0.5, 0.75)
    assert found.hota == pytest.approx(0.5**0.5, abs=1e-12)


def test_two_targets_that_pass_each_other_keep_their_names_as_long_as_they_are_within_half_the_cutoff() -> None:
    """Estimates at the other target, 1 m away, still match by name; with 6 m they do not, and both switch."""
    near = ticks_of([([1, 2], [0.0, 1.0], [5, 6], [0.0, 1.0]), ([1, 2], [0.0, 1.0], [5, 6], [1.0, 0.0])])
    far = ticks_of([([1, 2], [0.0, 6.0], [5, 6], [0.0, 6.0]), ([1, 2], [0.0, 6.0], [5, 6], [6.0, 0.0])])
    assert (track_score(near, 10.0).id_switches, track_score(far, 10.0).id_switches) == (0, 2)


def test_a_tick_without_estimates_or_without_targets_does_not_make_the_matches_before_it_forgotten() -> None:
    """After the gap each target is nearer to the estimate of the other, 3 m against 1 m, and both keep their names."""
    before, after = ([1, 2], [0.0, 3.0], [5, 6], [0.0, 3.0]), ([1, 2], [0.0, 3.0], [5, 6], [2.0, 1.0])
    for gap in (([1, 2], [0.0, 3.0], [], []), ([], [], [5, 6], [0.0, 3.0])):
        assert track_score(ticks_of([before, gap, after]), 10.0).id_switches == 0


def test_nothing_true_and_nothing_reported_scores_zero() -> None:
    for rows in ([], [([], [], [], [])]):
        found = track_score(ticks_of(rows), 10.0)
        assert (found.id_switches, found.idf1, found.hota, found.mota, track_ospa(ticks_of(rows), 10.0)) == (0, 0.0, 0.0, 0.0, 0.0)


def test_the_ospa_of_tracks_is_a_mean_over_the_ticks_of_both() -> None:
    """2 m apart in one tick and alone in the other: (2 + 10) / 2. A second track of nothing costs the cut-off: (6 + 10) / 2."""
    rows = [([1], [0.0], [5], [2.0]), ([1], [0.0], [], [])]
    assert track_ospa(ticks_of(rows), 10.0) == pytest.approx(6.0, abs=1e-12)
    rows[1] = ([1], [0.0], [8], [40.0])
    assert track_ospa(ticks_of(rows), 10.0) == pytest.approx(8.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_trackeval_and_motmetrics_give_the_same_numbers(seed: int) -> None:
    """Walks with noise, with gaps, with swapped names and with false estimates."""
    metrics, motmetrics = pytest.importorskip("trackeval").metrics, pytest.importorskip("motmetrics")
    rng, number = np.random.default_rng(seed), 5
    places, names, ticks = rng.random((number, 2)) * 30.0, np.arange(number), []
    for _ in range(60):
        places = places + rng.normal(0.0, 0.7, places.shape)
        if rng.random() < 0.1:
            names = rng.permutation(number + 2)[:number]
        there, seen, false = rng.random(number) < 0.9, rng.random(number) < 0.8, rng.random((int(rng.integers(2)), 2)) * 30.0
        estimates = np.vstack([places[seen] + rng.normal(0.0, 0.8, (int(seen.sum()), 2)), false])
        labels = np.concatenate([names[seen], np.full(len(false), number + 2)])
        ticks.append(TrackTick(np.flatnonzero(there), places[there], labels, estimates))
    known, found = np.unique(np.concatenate([tick.labels for tick in ticks])), track_score(ticks, 10.0)
    data = {
        "gt_ids": [tick.ids for tick in ticks],
        "tracker_ids": [known.searchsorted(tick.labels) for tick in ticks],
        "similarity_scores": [similarity(tick.targets, tick.estimates, 10.0) for tick in ticks],
        "num_gt_dets": sum(len(tick.ids) for tick in ticks),
        "num_tracker_dets": sum(len(tick.labels) for tick in ticks),
        "num_gt_ids": number,
        "num_tracker_ids": len(known),
        "num_timesteps": len(ticks),
    }
    quiet = {"PRINT_CONFIG": False}
    clear, identity = metrics.CLEAR(quiet).eval_sequence(data), metrics.Identity(quiet).eval_sequence(data)
    assert (found.id_switches, found.mota) == (int(clear["IDSW"]), pytest.approx(float(clear["MOTA"]), abs=1e-9))
    assert found.idf1 == pytest.approx(float(identity["IDF1"]), abs=1e-9)
    assert found.hota == pytest.approx(float(np.mean(metrics.HOTA().eval_sequence(data)["HOTA"])), abs=1e-9)
    scored = motmetrics.MOTAccumulator(auto_id=True)
    for tick, close in zip(ticks, data["similarity_scores"]):
        scored.update(tick.ids.tolist(), tick.labels.tolist(), np.where(close >= 0.5, 1.0 - close, np.nan))
    other = motmetrics.metrics.create().compute(scored, metrics=["idf1"]).iloc[0]
    assert found.idf1 == pytest.approx(float(other["idf1"]), abs=1e-9)
