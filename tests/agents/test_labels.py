"""Labels: what founds them, who inherits them, and which estimate bears which."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.compiled import label_kernels
from agents.config import AgentConfig, FilterSettings
from agents.tracking.births import Scan, founded_labels
from agents.tracking.extraction import estimate_targets
from agents.tracking.labels import birth_labels, derived_label, heaviest, mean_positions, name_peaks, renamed
from agents.tracking.particles import NO_PARTICLES, Particles, join
from agents.tracking.phd import correct, resample
from agents.tracking.step import Step
from deploy.scoring.tracks import UniqueLabels
from protocol.codec import decode, encode
from protocol.fields import Malformed, pack, pack_labels, read_labels
from protocol.messages import Gossip
from protocol.observer_messages import Estimate
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import DetectionSettings

CONFIG = AgentConfig(detection=DetectionSettings(noise=0.3), filter=FilterSettings(seed=1, vicinity=6.0))
EYE = SENSOR_CLASSES["A"]


def cloud(x: float, y: float, mass: float, label: int, count: int = 50, first: int = 1) -> Particles:
    """Particles of one label on a small cross, standing still."""
    angles = np.arange(count) * 2.4
    states = np.column_stack([x + 0.2 * np.cos(angles), y + 0.2 * np.sin(angles), np.zeros((count, 2))])
    ids = np.arange(first, first + count, dtype=np.uint64)
    return Particles(states, np.full(count, mass / count), ids, np.full(count, label, np.uint64))


def seen(particles: Particles, *detections: tuple[float, float], tick: int = 5) -> Particles:
    """The particles after a scan by a sensor 3 m to the west of (10, 10), with little clutter."""
    found = np.array(detections).reshape(-1, 2)
    scan = Scan(77, EYE, (7.0, 10.0, 0.0), found, np.arange(len(found), dtype=np.uint64), 1e-3)
    return correct(particles, [scan], Step(CONFIG, tick))


def test_a_detection_of_nothing_known_founds_a_label_and_its_births_bear_it() -> None:
    born = seen(NO_PARTICLES, (10.0, 10.0), (10.0, 10.5))
    labels = np.unique(born.labels)
    assert len(labels) == 2 and 0 not in labels and labels.max() < 2**53
    scan = Scan(77, EYE, (7.0, 10.0, 0.0), np.zeros((2, 2)), np.arange(2, dtype=np.uint64), 1e-3)
    assert set(labels.tolist()) == set(founded_labels(scan, Step(CONFIG, 5)).tolist())


def test_labels_of_later_ticks_are_larger_and_those_of_another_sensor_seed_or_detection_differ() -> None:
    def founded(salt: int, tick: int, seed: int, number: int) -> int:
        scan = Scan(salt, EYE, (0.0, 0.0, 0.0), np.zeros((1, 2)), np.array([number], dtype=np.uint64), 1e-3)
        return int(founded_labels(scan, Step(AgentConfig(filter=FilterSettings(seed=seed)), tick))[0])

    assert founded(77, 5, 1, 0) == founded(77, 5, 1, 0) < founded(78, 6, 2, 1)
    assert len({founded(77, 5, 1, 0), founded(78, 5, 1, 0), founded(77, 5, 2, 0), founded(77, 5, 1, 1)}) == 4


def test_births_beside_a_living_track_bear_its_label() -> None:
    born = seen(cloud(10.0, 10.0, 1.0, 9), (10.0, 10.0))
    assert len(born.ids) == 50 + CONFIG.birth.measurement_particles and set(born.labels.tolist()) == {9}


def test_births_at_a_detection_that_the_track_hardly_explains_found_a_label_of_their_own() -> None:
    born = seen(cloud(10.0, 10.0, 1.0, 9), (11.6, 10.0))
    assert 9 not in born.labels[50:].tolist() and set(born.labels[:50].tolist()) == {9}


def test_a_particle_without_a_label_takes_that_of_the_detection_that_it_lives_of() -> None:
    after = seen(cloud(10.0, 10.0, 0.02, 0), (10.0, 10.0))
    assert len(np.unique(after.labels)) == 1 and after.labels[0] != 0
    unseen = seen(cloud(10.0, 10.0, 0.02, 0), (10.0, 13.0))
    assert (unseen.labels[:50] == 0).all()


def test_all_copies_of_a_drawn_particle_keep_its_label() -> None:
    both = Particles(*(np.concatenate(parts) for parts in zip(cloud(10.0, 10.0, 0.9, 4), cloud(20.0, 10.0, 0.1, 6, first=100))))
    drawn = resample(both, "s1", Step(CONFIG, 3))
    assert (drawn.labels == np.where(drawn.states[:, 0] < 15.0, 4, 6)).all() and len(drawn.ids) > 60


def test_an_estimate_reports_the_label_the_velocity_the_covariance_and_the_existence_of_its_peak() -> None:
    peak = cloud(10.5, 10.5, 0.8, 9)
    peak.states[:, 2:] = 1.5, -0.5
    found = estimate_targets(peak)
    spread = float((peak.weights * (peak.states[:, 0] - found.positions[0, 0]) ** 2).sum() / 0.8)
    assert found.labels.tolist() == [9]
    assert found.details[0, [0, 1, 5]] == pytest.approx([1.5, -0.5, 0.8], abs=1e-12)
    assert found.details[0, 2] == pytest.approx(spread, abs=1e-12) and abs(found.details[0, 3]) < 0.01


TICK = 9
OLD, YOUNG, NEWER = 5, 3 + (TICK << 29), 7 + (TICK + 1 << 29)  # founded long before tick 9, one tick before it, and in it


def named(
    *peaks: dict[int, float], known: dict[int, tuple[float, float]] | None = None, tick: int = TICK + 100, size: float = 1.0
) -> list[int]:
    """The names of peaks at (0, 0), (10, 0), (20, 0), ..."""
    return name_peaks(list(peaks), np.column_stack([10.0 * np.arange(len(peaks)), np.zeros(len(peaks))]), known or {}, tick, size)


def test_of_two_peaks_with_one_label_the_heavier_keeps_it_and_the_other_takes_its_next_or_a_derived_one() -> None:
    assert named({5: 0.6, 7: 0.4}, {5: 0.9}) == [7, 5]
    assert named({5: 0.6}, {5: 0.9}) == [derived_label(5, 1), 5]
    assert named({5: 0.6}, {5: 0.6}, {5: 0.6}) == [5, derived_label(5, 1), derived_label(5, 2)]
    assert named({}, {5: 0.6}) == [0, 5] and named() == []
    assert named({900: 0.4, 5: 0.4}) == [5]


def test_a_peak_without_a_free_label_takes_the_nearest_one_within_5_bins_that_has_no_peak() -> None:
    """Label 7 has particles beside the first peak but none in it."""
    assert named({5: 0.6}, {5: 0.9}, known={5: (9.0, 0.0), 7: (3.0, 3.9), 8: (4.0, 3.0), 9: (0.0, 4.95)}) == [7, 5]
    assert named({5: 0.6}, {5: 0.9}, known={7: (3.0, 4.1)}) == [derived_label(5, 1), 5]
    assert named({}, {}, known={7: (6.0, 0.0), 8: (4.0, 0.0)}) == [8, 7]
    assert named({}, known={8: (3.0, 0.0), 7: (0.0, 3.0)}) == [7]
    assert named({}, known={7: (3.0, 0.0)}, size=0.5) == [0] and named({}, known={7: (6.0, 0.0)}, size=2.0) == [7]


def test_a_peak_whose_label_was_founded_within_4_ticks_takes_an_older_one_beside_it_that_has_no_peak() -> None:
    assert named({YOUNG: 0.6}, known={OLD: (3.0, 0.0)}, tick=TICK + 3) == [OLD]
    assert named({YOUNG: 0.6}, known={OLD: (3.0, 0.0)}, tick=TICK + 4) == [YOUNG]
    assert named({YOUNG: 0.6}, known={NEWER: (3.0, 0.0)}, tick=TICK) == [YOUNG]
    assert named({YOUNG: 0.6}, {OLD: 0.6}, known={OLD: (3.0, 0.0)}, tick=TICK) == [YOUNG, OLD]


def test_the_middle_of_a_label_is_the_mean_of_its_particles_and_a_faint_label_has_none() -> None:
    two = join([cloud(4.0, 5.0, 0.6, 5), cloud(8.0, 5.0, 0.2, 5, first=100), cloud(9.0, 9.0, 0.019, 7), cloud(3.0, 3.0, 0.5, 0)])
    assert (
        list(mean_positions(two)) == [5]
        and mean_positions(two)[5] == pytest.approx((5.0, 5.0), abs=0.01)
        and not mean_positions(NO_PARTICLES)
    )


def after(*clouds: Particles, estimates: list[tuple[float, float]], outside: Particles = NO_PARTICLES, size: float = 1.0) -> list[int]:
    """The label of each cloud of 50 particles in a cell after renaming; those `outside` lie in another cell."""
    everything = join([outside, *clouds])
    labels = renamed(everything, np.arange(len(everything.ids)) >= len(outside.ids), outside, np.array(estimates).reshape(-1, 2), size)
    assert (labels[: len(outside.ids)] == outside.labels).all()
    parts = labels[len(outside.ids) :].reshape(-1, 50)
    assert (parts == parts[:, :1]).all()
    return [int(part[0]) for part in parts]


def test_when_two_targets_part_the_particles_that_bear_the_label_of_the_other_one_are_renamed() -> None:
    """At the first estimate 0.3 of label 5 and 0.7 of label 7, at the second 0.9 of label 5."""
    mixed = cloud(5.0, 5.0, 0.3, 5), cloud(5.0, 5.0, 0.7, 7), cloud(9.0, 5.0, 0.9, 5)
    both = [(5.0, 5.0), (9.0, 5.0)]
    assert after(*mixed, estimates=both) == [7, 7, 5]
    assert after(*mixed[:2], estimates=both[:1], outside=mixed[2]) == [7, 7]  # the other target is in another cell
    assert after(*mixed, estimates=[*both, (5.0, 7.9)]) == [5, 7, 5]  # another estimate within 3 bins of 1 m
    assert after(*mixed, estimates=[*both, (5.0, 7.9)], size=0.8) == [7, 7, 5]
    assert after(*mixed[:2], estimates=both[:1]) == [5, 7]  # its own target may be here too
    assert after(*mixed[:2], cloud(11.5, 5.0, 0.9, 5), estimates=both[:1]) == [5, 7, 5]  # 6.5 m away
    assert after(*mixed, estimates=both, size=0.6) == [5, 7, 5]  # more than 6 bins away
    assert after(*mixed[:2], cloud(11.5, 5.0, 0.9, 5), estimates=both[:1], size=1.2) == [7, 7, 5]
    assert after(*mixed[:2], cloud(9.0, 5.0, 0.4, 5), estimates=both) == [5, 7, 5]  # too little there
    assert after(*mixed, estimates=[]) == [5, 7, 5] and after(estimates=both) == []


def test_of_two_targets_with_one_label_the_lighter_one_gets_a_derived_label() -> None:
    assert after(cloud(5.0, 5.0, 0.9, 5), cloud(9.0, 5.0, 1.0, 5), estimates=[(5.0, 5.0), (9.0, 5.0)]) == [derived_label(5, 1), 5]
    assert after(cloud(5.0, 5.0, 0.9, 5), estimates=[(5.0, 5.0)], outside=cloud(9.0, 5.0, 1.0, 5)) == [derived_label(5, 1)]
    assert after(cloud(5.0, 5.0, 1.0, 5), estimates=[(5.0, 5.0)], outside=cloud(9.0, 5.0, 0.9, 5)) == [5]
    assert after(cloud(5.0, 5.0, 0.3, 0), cloud(9.0, 5.0, 0.9, 0), estimates=[(5.0, 5.0)]) == [0, 0]


def test_the_heaviest_of_equal_labels_is_the_smallest_and_none_is_no_label() -> None:
    assert heaviest(np.array([9, 3, 0, 9], np.uint64), np.array([1.0, 2.0, 9.0, 1.0])) == (3, 2.0)
    assert heaviest(np.array([0], np.uint64), np.array([1.0])) == (0, 0.0) == heaviest(np.empty(0, np.uint64), np.empty(0))


def test_the_compiled_rules_give_the_same_labels() -> None:
    rng, beside, moved = np.random.default_rng(3), 0, 0
    choices = np.array([0, 5, 6, 7, YOUNG, YOUNG + 2, NEWER], np.uint64)
    for _ in range(400):
        peaks = [dict(zip(rng.permutation(6)[: rng.integers(4)].tolist(), rng.integers(1, 5, 4).tolist())) for _ in range(rng.integers(5))]
        peaks = [{int(choices[1 + label]): weight / 4.0 for label, weight in peak.items()} for peak in peaks]
        labels = np.array([label for peak in peaks for label in peak], dtype=np.uint64)
        weights = np.array([weight for peak in peaks for weight in peak.values()], dtype=float)
        starts = np.cumsum([0, *map(len, peaks)])
        places, number, tick = rng.integers(0, 9, (len(peaks), 2)).astype(float), int(rng.integers(0, 40)), TICK + int(rng.integers(0, 8))
        states = np.column_stack([rng.integers(0, 9, (number, 2)), np.zeros((number, 2))]).astype(float)
        ids = np.arange(number, dtype=np.uint64)
        every = Particles(states, rng.random(number) * 0.3, ids, choices[rng.integers(0, 7, number)])
        stamp = np.uint64(label_kernels.stamp_of(np.uint64(tick)))
        size = float(rng.choice([0.5, 1.0, 1.5]))
        cores = np.sort(
            np.append(np.arange(len(peaks)), rng.integers(0, len(peaks), 2) if peaks else []).astype(int)
        )  # some hold more peaks
        peaks, spots = [peaks[core] for core in cores], places[cores]
        plain = name_peaks(peaks, spots, mean_positions(every), tick, size)
        around = states, every.weights, every.labels
        numbers, numbered = label_kernels.number_labels(np.concatenate((every.labels, labels)))
        shares, particles = (numbers[number:], weights, starts, cores), (states, every.weights, numbers[:number])
        assert plain == label_kernels.name_peaks(shares, numbered, spots, particles, stamp, size).tolist()
        beside += plain != name_peaks(peaks, spots, {}, tick, size)
        owned, known = rng.random(number) < 0.7, int(rng.integers(0, number + 1))
        before = Particles(states[:known], rng.random(known) * 0.3, ids[:known], choices[rng.integers(0, 7, known)])
        new = renamed(every, owned, before, places, size)
        compiled = label_kernels.rename(around, owned, (before.weights, before.labels), places, size)
        assert (new == compiled).all() and (new == every.labels)[~owned].all()
        moved += int((new != every.labels).sum())
    assert beside > 100 and moved > 50
    bits = np.array([2**63 + 12345678901], dtype=np.uint64)
    assert int(birth_labels(bits, 9)[0]) == int(label_kernels.birth_label(bits[0], label_kernels.stamp_of(np.uint64(9))))


def by_the_rule(peaks: list[dict[int, float]]) -> list[int]:
    """The names of peaks of old labels with nothing beside them: always the heaviest pair that is left, then what is derived."""
    given: dict[int, int] = {}
    while True:
        left = [(-weight, label, number) for number, peak in enumerate(peaks) if number not in given for label, weight in peak.items()]
        left = [pair for pair in left if pair[1] not in given.values()]
        if not left:
            break
        given[min(left)[2]] = min(left)[1]
    for number, peak in enumerate(peaks):
        if number not in given and peak:
            heaviest = min(peak, key=lambda label: (-peak[label], label))
            derived = (derived_label(heaviest, count) for count in range(1, len(peaks) + 2))
            given[number] = next(label for label in derived if label not in given.values())
    return [given.get(number, 0) for number in range(len(peaks))]


@given(st.lists(st.dictionaries(st.sampled_from([5, 6, 7, 900, derived_label(5, 1)]), st.sampled_from([0.25, 0.5, 1.0]))))
def test_names_go_to_the_heaviest_pair_of_a_peak_and_a_label_that_is_left(peaks: list[dict[int, float]]) -> None:
    assert named(*peaks) == by_the_rule(peaks)


def test_labels_are_numbered_by_their_first_rows_also_when_many_are_alike() -> None:
    numbers, known = label_kernels.number_labels(np.array([7, 0, 5, 7, 2**53 - 1, 5], np.uint64))
    assert numbers.tolist() == [0, -1, 1, 0, 2, 1] and known.tolist() == [7, 5, 2**53 - 1]
    many = (np.arange(5000, dtype=np.uint64) << np.uint64(29)) | np.uint64(1)
    numbers, known = label_kernels.number_labels(np.concatenate((many, many[::-1])))
    assert (known == many).all() and (numbers == np.concatenate((np.arange(5000), np.arange(5000)[::-1]))).all()
    assert [len(part) for part in label_kernels.number_labels(many[:0])] == [0, 0]


def test_a_label_counts_once_in_a_tick_for_the_estimate_nearest_to_where_it_was_last() -> None:
    """A new label is that of the estimate of the largest existence."""
    names, other, none = UniqueLabels(), derived_label(5, 1), derived_label(0, 1)
    places = np.array([(0.0, 0.0), (9.0, 0.0), (20.0, 0.0), (30.0, 0.0)])
    assert names.of([5, 5, 0, 8], [0.5, 0.9, 1.0, 1.0], places).tolist() == [other, 5, none, 8]
    assert names.of([5, 5, 0, 8], [0.9, 0.5, 1.0, 1.0], places).tolist() == [other, 5, none, 8]
    assert names.of([], [], np.empty((0, 2))).tolist() == []
    assert names.of([5, 5], [0.9, 0.5], np.array([(4.0, 0.0), (15.0, 0.0)])).tolist() == [5, other]


def test_thousands_of_estimates_with_one_label_take_one_try_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Anybody may state them, and the scores of a tick must not take minutes."""
    tried: list[int] = []
    monkeypatch.setattr("deploy.scoring.tracks.derived_label", lambda label, number: tried.append(number) or derived_label(label, number))
    given = UniqueLabels().of([5 << 29] * 500 + [0] * 500, [0.5] * 1000, np.zeros((1000, 2)))
    assert len(set(given.tolist())) == 1000 and len(tried) == 999


def test_a_table_of_labels_costs_eight_bytes_a_label_and_one_or_two_a_particle() -> None:
    for labels, size in ((256, 1), (257, 2)):
        held = np.repeat(np.arange(labels, dtype=np.uint64) * 3, 2)[::-1]
        table, numbers = pack_labels(held)
        assert (len(table), len(numbers)) == (8 * labels, size * 2 * labels)
        assert (read_labels([(table, numbers, len(held))]) == held).all()
    some, many = np.array([5, 0, 9, 5], np.uint64), np.arange(300, dtype=np.uint64) + 7
    for parts in ([some, np.zeros(3, np.uint64), some[1:]], [some, many, np.zeros(2, np.uint64), many[::-1]]):
        assert read_labels([(*pack_labels(each), len(each)) for each in parts]).tolist() == np.concatenate(parts).tolist()
    assert pack_labels(np.zeros(4, np.uint64)) == (b"", b"") and read_labels([(b"", b"", 3)]).tolist() == [0, 0, 0]


def gossip(table: list[int], numbers: bytes, count: int = 3) -> Gossip:
    """A gossip with some particles."""
    return Gossip(
        sender="s1",
        incarnation=1,
        tick=4,
        claim_tick=3,
        pose=(1.0, 2.0, 0.0),
        cod=(1.0, 2.0),
        power_radius=1.0,
        unused=3.0,
        claim_names=("s1",),
        claim_bytes=pack(np.array([[1.0, 2.0, 1.0]]), "<f8"),
        states_bytes=pack(np.ones((count, 4)), "<f4"),
        ids_bytes=pack(np.arange(count), "<u8"),
        labels_bytes=pack(np.array(table, dtype=np.uint64), "<u8"),
        label_numbers_bytes=numbers,
    )


@pytest.mark.parametrize(
    ("table", "numbers", "reason"),
    [
        ([4, 9], b"\0\1\1", None),
        ([], b"", None),
        ([0], b"\0\0\0", None),
        ([4, 9], b"\0\1\2", "shape"),  # no label has this number
        ([4, 9], b"\0\1", "shape"),  # a particle too few
        ([4, 9], b"", "shape"),
        ([], b"\0\0\0", "shape"),
        ([4, 4], b"\0\1\1", "range"),  # twice the same
        ([9, 4], b"\0\1\1", "range"),
        ([4, 2**53], b"\0\1\1", "range"),
        (list(range(257)), b"\0\0\0", "shape"),  # so many need two bytes each
        (list(range(257)), b"\0\0\0\1\1\1", "shape"),  # 256 is the largest number
        (list(range(257)), b"\0\0\0\1\1\0", None),
        (list(range(8193)), b"\0" * 6, "size"),
    ],
)
def test_labels_are_checked_where_a_gossip_is_decoded(table: list[int], numbers: bytes, reason: str | None) -> None:
    payload = encode(gossip(table, numbers))
    if reason is None:
        labels = decode("covey/demo/gossip/s1", payload).labels  # type: ignore[attr-defined]
        assert len(labels) == 3
    else:
        with pytest.raises(Malformed, match="label") as refused:
            decode("covey/demo/gossip/s1", payload)
        assert refused.value.reason == reason


def test_an_estimate_whose_labels_or_details_do_not_fit_its_targets_is_refused() -> None:
    said = Estimate(sender="s1", incarnation=1, tick=1, pose=(0.0, 0.0, 0.0), cod=(0.0, 0.0), power_radius=0.0, unused=0.0)
    two = msgspec.structs.replace(said, targets_bytes=pack(np.ones((2, 2)), "<f8"))
    two.check()
    assert two.labels.tolist() == [0, 0] and two.details.shape == (2, 6)
    for wrong in ({"labels_bytes": bytes(8)}, {"details_bytes": bytes(24)}, {"labels_bytes": pack(np.full(2, 2**53), "<u8")}):
        with pytest.raises(Malformed, match="labels"):
            msgspec.structs.replace(two, **wrong).check()
