"""Whose settings are mine: who differs computes parts of another PHD, is refused, and is named once."""

from collections import Counter
from collections.abc import Sequence

from protocol.agreement import disagreement, whole
from protocol.messages import Agreed, Beacon, Hello
from protocol.node import Effect, Warn


class SettingsAgreement:
    """The settings of one agent, beside those that others announce."""

    def __init__(self, name: str, settings: Agreed, counters: Counter[str]) -> None:
        self.settings = settings
        self._name, self._seal = name, whole(settings)
        self._counters = counters
        self._warned: set[tuple[str, int]] = set()  # name and incarnation

    def differs(self, word: Hello | Beacon) -> bool:
        """Whether somebody announces other settings."""
        if isinstance(word, Beacon):
            return word.settings not in (0, self._seal)
        return bool(disagreement(self.settings, word.settings))

    def refuse(self, words: Sequence[Hello | Beacon]) -> list[Effect]:
        """Count those who differ; a warning for each that is new."""
        self._counters["rejected.settings"] += len(words)
        return [warning for word in words for warning in self._warn(word)]

    def _warn(self, word: Hello | Beacon) -> list[Effect]:
        """A warning, the first time that an incarnation differs: in which settings, which a beacon does not say."""
        who = (word.sender, word.incarnation)
        if who in self._warned:
            return []
        self._warned.add(who)
        fields = disagreement(self.settings, word.settings) if isinstance(word, Hello) else ()
        where = ", ".join(fields) or "a setting that only its Hello names"
        consequence = "" if word.sender == "world" else ": it computes another PHD and is refused"
        return [Warn(f"the settings of {word.sender} differ from those of {self._name} in {where}{consequence}")]
