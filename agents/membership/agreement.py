"""The settings that a swarm must share. An agent with other settings computes another PHD: it is refused, and named once in a warning."""

from collections import Counter
from collections.abc import Sequence

from protocol.message import SharedSettings
from protocol.messages import Beacon, Hello
from protocol.node import Effect, Warn
from protocol.settings_digest import differing_settings, settings_digest

MOST_WARNINGS = 64  # of one agent. More help nobody: all are counted, and anybody can make up names


class SettingsAgreement:
    """The settings of one agent, compared with those that others announce."""

    def __init__(self, name: str, settings: SharedSettings) -> None:
        self.settings, self.digest = settings, settings_digest(settings)
        self._name = name
        self._warned: set[tuple[str, int]] = set()  # name and incarnation

    def differing(self, hello: Hello) -> tuple[str, ...]:
        """The settings that a Hello announces with other values, as `section.name`."""
        return () if hello.digest == self.digest else differing_settings(self.settings, hello.settings)

    def with_others(self, beacons: Sequence[Beacon]) -> list[Beacon]:
        """The beacons that announce other settings."""
        agreed = 0, self.digest
        return [beacon for beacon in beacons if beacon.settings not in agreed]

    def refuse(self, messages: Sequence[Hello | Beacon], counters: Counter[str]) -> list[Effect]:
        """Count messages with other settings, and return a warning for each new sender."""
        counters["rejected.settings"] += len(messages)
        return [warning for message in messages for warning in self._warn(message)]

    def _warn(self, message: Hello | Beacon) -> list[Effect]:
        """A warning, the first time that an incarnation differs. A Hello names the settings that differ; a beacon holds only their hash."""
        announcer = (message.sender, message.incarnation)
        if announcer in self._warned or len(self._warned) >= MOST_WARNINGS:
            return []
        self._warned.add(announcer)
        fields = self.differing(message) if isinstance(message, Hello) else ()
        where = ", ".join(fields) or "a setting that only its Hello names"
        consequence = "" if message.sender == "world" else ": it computes another PHD and is refused"
        return [Warn(f"the settings of {message.sender} differ from those of {self._name} in {where}{consequence}")]
