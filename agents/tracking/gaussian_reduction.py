"""Fewer components for nearly the same density: components that stand for one target are merged, light ones are dropped.

Rules. Merging keeps mass, mean and covariance. It goes from the heaviest component on, ties by id, and looks at near components only.
"""

import math

import numpy as np

from agents.config import MixtureSettings
from agents.tracking.extraction import DETAILS, TargetEstimates
from agents.tracking.gaussians import Mixture, factors, largest_variances
from agents.tracking.labels import heaviest_label, name_peaks, weight_by_label
from agents.tracking.particles import join, select, total
from protocol.gaussian_components import MOST_OWN_MASS

STRIP = 1024  # components whose pairs are looked at together, so that they take little memory
ALIKE = 9.0  # a component merges with one of at most this many times its variance


def merged(mixture: Mixture, settings: MixtureSettings) -> Mixture:
    """The mixture in which components close to a heavier one are merged with it, and have its id and label.

    Close means: each mean lies within `settings.merged` squared standard deviations of the other component, and the variances of the
    places differ by a factor of at most `ALIKE`. A merged place is no wider than `settings.spread`. Components without weight are dropped.
    """
    mixture = select(mixture, mixture.weights > 0.0)
    order = np.lexsort((mixture.ids, -mixture.weights.astype(np.float32)))  # as on the wire: a difference of one bit must not grow
    partners = _close_pairs(mixture, settings.merged)
    taken, found = np.zeros(len(order), dtype=bool), list[Mixture]()
    alone = []
    for heaviest in order.tolist():
        if taken[heaviest]:
            continue
        group = [other for other in partners.get(heaviest, ()) if not taken[other]]
        whole = _as_one(mixture, [heaviest, *group]) if group else None
        if whole is None or largest_variances(whole)[0] > settings.spread**2:
            alone.append(heaviest)
            taken[heaviest] = True
            continue
        taken[[heaviest, *group]] = True
        found.append(whole)
    return join([select(mixture, np.array(alone, dtype=np.int64)), *found])


def _close_pairs(mixture: Mixture, most: float) -> dict[int, list[int]]:
    """The components close to each component, by its number; those with none are left out."""
    rows, columns = _near_pairs(mixture, most)
    if not len(rows):
        return {}
    factor, apart = factors(mixture.covariances), mixture.means[rows] - mixture.means[columns]
    close = (_squared(apart, factor[rows]) <= most) & (_squared(apart, factor[columns]) <= most)
    found: dict[int, list[int]] = {}
    for one, other in zip(rows[close].tolist(), columns[close].tolist()):
        found.setdefault(one, []).append(other)
        found.setdefault(other, []).append(one)
    return found


def _near_pairs(mixture: Mixture, most: float) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of components, in order, of alike variances and with places no farther apart than the narrower one allows.

    Each component is compared with those that follow it from west to east, as far as it reaches itself.
    """
    order = np.argsort(mixture.means[:, 0], kind="stable")
    x, y = mixture.means[order, 0], mixture.means[order, 1]
    sizes = (mixture.covariances[:, 0, 0] + mixture.covariances[:, 1, 1])[order]
    ends = np.searchsorted(x, x + 1.001 * np.sqrt(most * sizes) + 1e-6, side="right")  # a little more: sums are rounded
    found = [np.empty((2, 0), dtype=np.int64)]
    for start in range(0, len(order), STRIP):
        west = np.arange(start, min(start + STRIP, len(order)))
        numbers = ends[west] - west - 1
        one = np.repeat(west, numbers)
        other = one + 1 + np.arange(len(one)) - np.repeat(np.cumsum(numbers) - numbers, numbers)
        dx, dy, least = x[one] - x[other], y[one] - y[other], np.minimum(sizes[one], sizes[other])
        near = (dx * dx + dy * dy <= most * least) & (sizes[one] <= ALIKE * least) & (sizes[other] <= ALIKE * least)
        found.append(np.stack([order[one[near]], order[other[near]]]))
    rows, columns = np.sort(np.concatenate(found, axis=1), axis=0)
    ascending = np.lexsort((columns, rows))
    return rows[ascending], columns[ascending]


def _squared(apart: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """The squared Mahalanobis distances (P,) of differences (P, 4), by the Cholesky factors (P, 4, 4) of the covariances."""
    found, scaled = np.zeros(len(apart)), np.empty_like(apart)
    for row in range(4):
        rest = apart[:, row]
        for before in range(row):
            rest = rest - factor[:, row, before] * scaled[:, before]
        scaled[:, row] = rest / factor[:, row, row]
        found = found + scaled[:, row] * scaled[:, row]
    return found


def _as_one(mixture: Mixture, rows: list[int]) -> Mixture:
    """The one component with mass, mean and covariance of several; id and label are those of the first."""
    group = select(mixture, np.array(rows))
    mass = total(group.weights)
    mean, covariance = _moments(group, mass)
    return Mixture(np.array([mass]), mean[None], covariance[None], group.ids[:1], group.labels[:1])


def _moments(group: Mixture, mass: float) -> tuple[np.ndarray, np.ndarray]:
    """The mean (4,) and the covariance (4, 4) of components with `mass` expected targets together."""
    shares = group.weights / mass
    mean, covariance = np.zeros(4), np.zeros((4, 4))
    for share, one in zip(shares.tolist(), group.means):
        mean = mean + share * one
    for share, one, spread in zip(shares.tolist(), group.means, group.covariances):
        covariance = covariance + share * (spread + (one - mean)[:, None] * (one - mean)[None, :])
    return mean, covariance


def limited(mixture: Mixture, most: int) -> Mixture:
    """The `most` heaviest components, scaled to the mass of all, but `MOST_OWN_MASS` at most; the order stays."""
    mass = total(mixture.weights)
    if len(mixture.ids) <= most and mass <= MOST_OWN_MASS:
        return mixture
    found = select(mixture, np.sort(np.lexsort((mixture.ids, -mixture.weights))[:most]))
    return found._replace(weights=found.weights * (min(mass, MOST_OWN_MASS) / total(found.weights)))


def estimate_and_label(mixture: Mixture, threshold: float, beside: float, radius: float) -> tuple[TargetEstimates, Mixture]:
    """Estimated targets, heaviest first, and the mixture with the labels that they found.

    The heaviest component and those within `radius` m of it are a peak while they hold at least `threshold` expected targets. A peak of
    more is several targets: each further one must hold `beside`, if that is more. If those with the label of the heaviest one hold as
    much, and the others too, only those with the label are the peak. Components wider than `radius` show no place. Labels are those of
    `labels.name_peaks`. A label stands for one target: where a peak of one target finds no free label, the components of its heaviest
    one take a new one.
    """
    further = max(threshold, beside)
    wide = largest_variances(mixture) > radius * radius
    left, found = np.where(wide, 0.0, mixture.weights), list[tuple[float, ...]]()
    members, votes = list[np.ndarray](), list[dict[int, float]]()
    for heaviest in np.lexsort((mixture.ids, -left)).tolist():
        if left[heaviest] <= 0.0:
            continue
        apart = mixture.means[:, :2] - mixture.means[heaviest, :2]
        near = np.flatnonzero((apart[:, 0] * apart[:, 0] + apart[:, 1] * apart[:, 1] <= radius * radius) & (left > 0.0))
        mine = near[mixture.labels[near] == mixture.labels[heaviest]]
        if min(total(left[mine]), total(left[near]) - total(left[mine])) >= further:
            near = mine
        mass = total(left[near])
        if mass < threshold:
            continue
        peak = select(mixture, near)
        mean, covariance = _moments(peak, mass)
        number = max(1, math.floor(mass + 1.0 - further))
        found += [(*mean.tolist(), covariance[0, 0], covariance[0, 1], covariance[1, 1], min(1.0, mass / number))] * number
        votes += [weight_by_label(peak.labels, peak.weights)] * number
        members += [near if number == 1 else near[:0]] * number
        left[near] = 0.0
    rows = np.array(found).reshape(-1, 2 + DETAILS)
    given = name_peaks(votes, rows[:, :2], {}, tick=0, size=1.0)  # no label without a peak is taken: neither matters
    labels = mixture.labels.copy()
    for near, vote, label in zip(members, votes, given):
        if vote and label not in vote:
            labels[near[labels[near] == heaviest_label(vote)]] = label
    return TargetEstimates(rows[:, :2], rows[:, 2:], np.array(given, dtype=np.uint64)), mixture._replace(labels=labels)
