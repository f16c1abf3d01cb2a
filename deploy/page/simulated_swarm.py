"""A simulated swarm beside another one of the same scenario and seed: a simulation that is played tick by tick, and its picture."""

from collections.abc import Sequence
from typing import Any

from deploy.faults.faults import Action
from deploy.page.frames import beside
from deploy.page.picture import Picture
from deploy.scenario import Scenario, has_targets
from deploy.scoring.scorer import Score
from deploy.simulation import Simulation
from protocol.settings import BadSetting

DONE_TO_BOTH = ("kill", "restart")  # verbs of the page


def about_two(left: str, scores: Sequence[Score], right: "SimulatedSwarm") -> dict[str, Any]:
    """What a page must know to show two swarms: their names, and the errors of the right one at the points of the left curves."""
    return {"names": [left, right.name], "ospa": beside(scores, right.scores, has_targets(right.picture.scenario))}


class SimulatedSwarm:
    """One of two swarms in the same arena; `name` says how it differs from the other."""

    def __init__(self, name: str, scenario: Scenario) -> None:
        self.name = name
        self.failure: BadSetting | None = None  # what has ended it
        self.simulation = Simulation(scenario)
        self.picture = Picture(self.simulation.scenario)
        self.simulation.scorer.on_event = self.picture.see
        self.simulation.scorer.on_fault = self.picture.note_fault
        self.simulation.on_refused = self._note_refusal

    @property
    def tick(self) -> int:
        """The newest tick of the world; -1 before the first."""
        truth = self.simulation.scorer.truth
        return truth.tick if truth else -1

    @property
    def scores(self) -> Sequence[Score]:
        """All so far, oldest first."""
        return self.simulation.scorer.scores

    def score(self) -> Score | None:
        """The last but one: of its tick everything has been heard."""
        return self.scores[-2] if len(self.scores) > 1 else None

    def play(self, tick: int) -> None:
        """Go on until the world has come to a tick, or to its end. A class of the user's that fails is the end of it."""
        try:
            while self.failure is None and self.tick < tick and self.simulation.bus.step():
                pass
        except BadSetting as error:
            self.failure = error

    def _note_refusal(self, refused: BadSetting) -> None:
        self.picture.note("told", "", f"{self.name}: {refused}")

    def strike(self, verb: str, who: str) -> None:
        """Kill an agent, or start it again."""
        self.simulation.injector.strike(Action(verb, [who]))
