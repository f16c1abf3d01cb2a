"""Random streams by purpose: every draw is keyed by (run seed, purpose, indices), never by the order of calls.

There are two kinds. `stream` returns a numpy Generator for values that are drawn in sequence (target tracks, start poses).
`random_key`, `scramble`, `uniform` and `normal` are counter-based: pure functions of integers, vectorised. They consist of integer
operations and exact floating-point steps only, so every process and every machine computes the same bits. `scramble`, `uniform` and
`normal` take arrays or single numbers, and compiled loops are made of them (agents/compiled/particle_kernels.py).
"""

import math
import zlib
from functools import lru_cache

import numpy as np

_MASK = (1 << 64) - 1
_GOLDEN = 0x9E3779B97F4A7C15
_MIX1, _MIX2 = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def _mix(word: int) -> int:
    """The splitmix64 finaliser of one 64-bit word (Steele, Lea and Flood, OOPSLA 2014)."""
    word = ((word ^ (word >> 30)) * _MIX1) & _MASK
    word = ((word ^ (word >> 27)) * _MIX2) & _MASK
    return word ^ (word >> 31)


@lru_cache(maxsize=128)  # in a simulation all agents use the keys of the same tick; older keys are not needed
def random_key(*parts: int | str) -> int:
    """The 64-bit key of a tuple of integers and words: the same tuple, the same key, on every machine."""
    word = _GOLDEN
    for part in parts:
        number = zlib.crc32(part.encode()) | (len(part) << 32) if isinstance(part, str) else int(part) & _MASK
        word = _mix((word ^ number) + _GOLDEN & _MASK)
    return word


def stream(seed: int, purpose: str, *indices: int) -> np.random.Generator:
    """A numpy Generator that depends on (seed, purpose, indices) alone."""
    return np.random.Generator(np.random.PCG64(random_key(seed, purpose, *indices)))


def scramble(words: np.ndarray, salt: int | np.ndarray) -> np.ndarray:
    """Independent-looking 64-bit hashes of `words` (N,) uint64 under the key `salt`, or each under its own key of an array (N,)."""
    words = words ^ np.uint64(salt)
    words = words + np.uint64(_GOLDEN)
    words = (words ^ (words >> np.uint64(30))) * np.uint64(_MIX1)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(_MIX2)
    return words ^ (words >> np.uint64(31))


def uniform(bits: np.ndarray) -> np.ndarray:
    """Uniform variates in [0, 1) from 64-bit hashes: the top 53 bits."""
    return (bits >> np.uint64(11)) * 2.0**-53


NORMAL_BOUND = 2.0 * math.sqrt(3.0)  # bound of |normal|, which keeps prediction local


def normal(bits: np.ndarray) -> np.ndarray:
    """Nearly standard normal variates, |z| < 2 sqrt(3), from 64-bit hashes: the sum of four 16-bit uniforms (Irwin-Hall).

    Integer sums and one multiplication, hence bit-equal everywhere; mean 0, variance 1, kurtosis 2.7.
    """
    low = np.uint64(0xFFFF)
    total = (bits & low) + (bits >> np.uint64(16) & low) + (bits >> np.uint64(32) & low) + (bits >> np.uint64(48))
    return (total - 131070.0) * (math.sqrt(3.0) / 65536.0)
