"""Settling: a label stands for one target, and the owner of a cell sees to it."""

import numpy as np
import pytest

from agents.compiled import label_kernels, settling_kernels
from agents.tracking import settling
from agents.tracking.labels import birth_labels
from agents.tracking.particles import NONE, Particles, join
from agents.tracking.settling import settled

REACH, TICK = 6.0, 12


def cloud(x: float, mass: float, label: int, vx: float = 0.0, count: int = 40) -> Particles:
    """Particles of one label around (x, 5), of the velocity (vx, 0)."""
    angles = np.arange(count) * 2.4
    states = np.column_stack([x + 0.2 * np.cos(angles), 5.0 + 0.2 * np.sin(angles), np.full(count, vx), np.zeros(count)])
    ids = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(2**40) + np.uint64(1000.0 * (x + vx) + label)
    return Particles(states, np.full(count, mass / count), ids, np.full(count, label, np.uint64))


def after(*clouds: Particles, outside: Particles = NONE) -> np.ndarray:
    """The labels of clouds in a cell after settling; the particles `outside` lie in another one."""
    everything = join([outside, *clouds])
    owned = np.arange(len(everything.ids)) >= len(outside.ids)
    return settled(everything, owned, outside, REACH, TICK)[len(outside.ids) :]


def mass_of(labels: np.ndarray, label: int, *clouds: Particles) -> float:
    return float(join(list(clouds)).weights[labels == label].sum())


def test_one_target_of_one_label_stays_as_it_is() -> None:
    assert (after(cloud(5.0, 1.3, 5)) == 5).all() and not len(after())
    assert (after(cloud(5.0, 1.9, 0)) == 0).all()


def test_of_two_targets_in_one_place_the_label_that_has_nearly_died_out_gets_back_the_particles_that_fly_like_it() -> None:
    """Label 5 holds 1.9 targets, of which 0.95 fly like label 7."""
    clouds = cloud(5.0, 0.95, 5, vx=1.0), cloud(5.0, 0.95, 5, vx=-1.0), cloud(5.0, 0.1, 7, vx=-1.0)
    labels = after(*clouds)
    assert (labels[:40] == 5).all() and (labels[80:] == 7).all()
    assert mass_of(labels, 7, *clouds) == pytest.approx(1.0, abs=0.95 / 40) and (labels[40:80] == 7).sum() >= 36


def test_a_label_far_away_gets_nothing() -> None:
    labels = after(cloud(5.0, 1.9, 5), cloud(9.0, 0.1, 7))
    assert (labels[:40] == 5).all() and (labels[40:] == 7).all()


def test_of_two_targets_of_one_label_that_part_one_founds_a_label() -> None:
    clouds = cloud(3.0, 1.0, 5), cloud(7.5, 0.98, 5)
    labels = after(*clouds)
    new = labels[labels != 5]
    assert len(set(new.tolist())) == 1 and new[0] >> np.uint64(29) == TICK + 1
    assert int(new[0]) in {int(birth_labels(clouds[part].ids[n : n + 1], TICK)[0]) for part in (0, 1) for n in range(40)}
    assert len(new) in (39, 40) and (labels[:40] == 5).all() | (labels[40:] == 5).all()


def test_of_two_cells_with_the_same_label_the_one_with_less_of_it_gives_way() -> None:
    lighter, heavier = cloud(3.0, 0.9, 5), cloud(6.0, 1.0, 5)
    assert len(set(after(lighter, outside=heavier).tolist())) == 1 and 5 not in after(lighter, outside=heavier)
    assert (after(heavier, outside=lighter) == 5).all()
    assert (after(lighter, outside=cloud(9.5, 1.0, 5)) == 5).all()  # farther away than the reach


def test_the_older_of_two_labels_on_one_target_takes_over_the_lighter_younger_one() -> None:
    assert (after(cloud(5.0, 0.6, 5), cloud(5.2, 0.4, 7)) == 5).all()
    assert set(after(cloud(5.0, 0.4, 5), cloud(5.2, 0.6, 7)).tolist()) == {5, 7}
    assert set(after(cloud(5.0, 0.9, 5), cloud(5.2, 0.8, 7)).tolist()) == {5, 7}  # two targets
    assert set(after(cloud(5.0, 0.6, 5), cloud(7.0, 0.4, 7)).tolist()) == {5, 7}  # 2 m apart


def test_the_compiled_rules_settle_alike() -> None:
    names = ("TOO_MUCH", "SPLIT", "NEAR", "FAR", "SAME", "ONE", "LEAST")
    assert [getattr(settling, name) for name in names] == [getattr(settling_kernels, name) for name in names]
    rng, changed = np.random.default_rng(4), 0
    for _ in range(200):
        number = int(rng.integers(0, 250))
        before = int(rng.integers(0, number + 1))
        places = np.column_stack([rng.choice([3.0, 5.0, 9.0], number), rng.choice([3.0, 5.0, 7.0], number)])
        states = np.column_stack([places + rng.normal(0.0, 0.8, (number, 2)), rng.normal(0.0, 1.0, (number, 2))])
        labels = rng.choice([0, 5, 7, 9, 11], number, p=[0.1, 0.5, 0.2, 0.15, 0.05]).astype(np.uint64)
        all_of = Particles(states, rng.random(number) * 0.03, rng.integers(1, 2**63, number).astype(np.uint64), labels)
        known = rng.choice([0, 5, 7, 9], before).astype(np.uint64)
        predicted = Particles(states[:before], rng.random(before) * 0.03, all_of.ids[:before], known)
        owned, stamp = rng.random(number) < 0.7, label_kernels.stamp_of(np.uint64(TICK))
        plain = settled(all_of, owned, predicted, REACH, TICK)
        fast = settling_kernels.settle(tuple(all_of), owned, (predicted.weights, known), REACH, stamp)
        assert (plain == fast).all() and (plain[~owned] == labels[~owned]).all()
        changed += int((plain != labels).sum())
    assert changed > 1000
