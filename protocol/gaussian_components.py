"""The components of a Gaussian mixture on the wire: rows of 52 bytes, without padding.

A row holds the weight, the mean place and velocity, the lower Cholesky factor of the covariance row by row, the id and the label. A factor
of any finite numbers gives a covariance, so that rounding it to 16 bits breaks none. Lengths in m, times in s.
"""

import numpy as np

from protocol.fields import LARGEST_LABEL, LARGEST_NUMBER, Malformed

MAX_COMPONENTS = 4096
MOST_MASS = 1000.0  # expected targets of one owner. Every one is an estimate: 1000 are found and named in 0.06 s, 3000 in 0.5 s
MOST_OWN_MASS = 0.999 * MOST_MASS  # that an agent states of its cell: sums are rounded, and a gossip of more is refused
COMPONENT = np.dtype(
    [("weight", "<f4"), ("place", "<f4", 2), ("velocity", "<f2", 2), ("factor", "<f2", 10), ("id", "<u8"), ("label", "<u8")]
)


def read_components(data: bytes) -> np.ndarray:
    """The rows (N,) of `COMPONENT`, read-only; raises Malformed for a part of a row or too many rows."""
    rows, rest = divmod(len(data), COMPONENT.itemsize)
    if rest:
        raise Malformed("shape", f"components: {len(data)} bytes are no whole number of rows of {COMPONENT.itemsize} bytes")
    if rows > MAX_COMPONENTS:
        raise Malformed("size", f"components: {rows} rows, at most {MAX_COMPONENTS} are allowed")
    return np.frombuffer(data, COMPONENT)


def check_mass(what: str, mass: float) -> None:
    """Refuse a mass in expected targets that is too large: receivers take as many estimates from it, one after the other."""
    if mass > MOST_MASS:
        raise Malformed("range", f"{what} hold {mass:g} expected targets, at most {MOST_MASS:g} are allowed")


def check_components(data: bytes) -> None:
    """Refuse numbers that are not finite or beyond `LARGEST_NUMBER`, negative weights, too much mass, ids that do not ascend, and labels
    that are too large.
    """
    if not data:
        return
    rows = read_components(data)
    if not bool(
        np.all(np.abs(rows["place"]) <= LARGEST_NUMBER) and np.all(np.isfinite(rows["velocity"])) and np.all(np.isfinite(rows["factor"]))
    ):
        raise Malformed("range", f"components: every number should be finite, and a place within +-{LARGEST_NUMBER:g}")
    if not bool(np.all((rows["weight"] >= 0.0) & (rows["weight"] <= LARGEST_NUMBER))):
        raise Malformed("range", f"components: every weight should be from 0 to {LARGEST_NUMBER:g}")
    check_mass("components: they", float(rows["weight"].sum(dtype=float)))
    if bool(np.any(rows["id"][1:] <= rows["id"][:-1])):
        raise Malformed("range", "components: ids should be strictly ascending")
    if bool(np.any(rows["label"] > LARGEST_LABEL)):
        raise Malformed("range", f"components: every label should be at most {LARGEST_LABEL}")
