"""What all who have heard the same work out alike: their cells, their claims, and what each makes of the particles around it.

In virtual time many agents live in one process, and those that hear everybody hear the same. What follows from that alone is worked
out once, for all of them, when a second one asks: bit for bit what each would have found by itself, as it does in a process of its own.
"""

from itertools import accumulate, pairwise

import numpy as np

from agents.arithmetic import Arithmetic, Parts, Refreshed
from agents.cells import Cell
from agents.claims import NO_CLAIM, Claim
from agents.config import AgentConfig
from agents.step import Step
from agents.words import Words

SOMEBODY = ""  # nobody's name: has asked when it is known beforehand that several will


class Chorus:
    """The common part of a round of all whose gossips stand side by side; what it gives is in the order of their names."""

    def __init__(self, words: Words, arithmetic: Arithmetic, config: AgentConfig, arena: np.ndarray) -> None:
        self.config, self.arithmetic = config, arithmetic
        cells = arithmetic.cut_all(words.points, words.radii, arena)
        self.parts = Parts(cells, _claims(cells, words))
        self._refreshed: tuple[int, list[Refreshed]] | None = None

    def refreshed(self, words: Words, step: Step) -> list[Refreshed]:
        """What each makes of the particles, when nothing counts but what these gossips say, the same as before."""
        if self._refreshed is None or self._refreshed[0] != step.tick:
            births = self.arithmetic.births(step)
            self._refreshed = step.tick, self.arithmetic.refresh_all(words, births, self.parts, step)
        return self._refreshed[1]


def _claims(cells: list[Cell], words: Words) -> list[Claim]:
    """Each cell as generators, the own one first; the names that speak are in order, so whose index is smaller comes first."""
    names, ends = words.names, list(accumulate([len(cell.bounds) for cell in cells], initial=0))
    bounds = np.array([index for cell in cells for index in cell.bounds], dtype=np.int64)
    generators, first = words.generators[bounds], bounds < np.repeat(np.arange(len(cells)), np.diff(ends))
    return [
        Claim(tuple([names[index] for index in cell.bounds]), generators[start:end], first[start:end]) if cell.bounds else NO_CLAIM
        for cell, (start, end) in zip(cells, pairwise(ends))
    ]


def chorus_of(words: Words, asker: str, arithmetic: Arithmetic, config: AgentConfig, arena: np.ndarray) -> Chorus | None:
    """What those who hear these gossips share, if somebody else in this process has asked for it; None: the asker works for itself."""
    known = words.chorus
    if config.timing.interest != "all" or words.listening or known == asker:
        return None
    if known is None:
        words.chorus = asker
        return None
    if isinstance(known, str) or known.config is not config or known.arithmetic is not arithmetic:
        known = words.chorus = Chorus(words, arithmetic, config, arena)
    return known
