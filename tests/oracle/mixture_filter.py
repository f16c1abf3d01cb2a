"""The corrector of the Gaussian-mixture PHD filter as Vo and Ma print it (2006, table I), for a detection probability that is constant.

A component is a tuple of weight, mean (4,) and covariance (4, 4); a detection (2,) measures the place with the covariance `noise`.
"""

import numpy as np
from scipy.stats import multivariate_normal

Component = tuple[float, np.ndarray, np.ndarray]
PLACE = np.eye(2, 4)  # H


def missed(mixture: list[Component], probability: float) -> list[Component]:
    """The components as missed ones."""
    return [((1.0 - probability) * weight, mean, covariance) for weight, mean, covariance in mixture]


def detected(mixture: list[Component], detections: np.ndarray, noise: np.ndarray, probability: float, clutter: float) -> list[Component]:
    """A component for each detection and each component, `clutter` false detections per m^2 among them."""
    found = []
    for detection in detections:
        pairs = []
        for weight, mean, covariance in mixture:
            innovation = PLACE @ covariance @ PLACE.T + noise
            gain = covariance @ PLACE.T @ np.linalg.inv(innovation)
            likelihood = multivariate_normal.pdf(detection, PLACE @ mean, innovation)
            corrected = mean + gain @ (detection - PLACE @ mean)
            pairs.append((probability * weight * likelihood, corrected, (np.eye(4) - gain @ PLACE) @ covariance))
        whole = clutter + sum(weight for weight, _, _ in pairs)
        found += [(weight / whole, mean, covariance) for weight, mean, covariance in pairs]
    return found
