"""`covey bench bodies`: how fast bodies are simulated, agents included. Whether they touch: `covey study bodies`."""

from collections.abc import Iterator

from deploy.bench.timing import BenchRow, in_turns
from deploy.simulation import Simulation
from deploy.studies.bodies import MODELS, BodyRun

TEAM, SECONDS, TURNS = "A8,B8", 20.0, 3


def measure() -> Iterator[BenchRow]:
    """A row for each model of bodies: 16 robots without deaths, least CPU time of some turns; the first turn warms up."""
    runs = {
        model: BodyRun(model=model, seed=1, seconds=SECONDS, deaths=False, options={"team.composition": TEAM}).resolve() for model in MODELS
    }
    times = in_turns({model: lambda given=given: Simulation(given).run() for model, given in runs.items()}, TURNS + 1)  # type: ignore[misc]
    for model, found in times.items():
        speeds = sorted(SECONDS / seconds for seconds in found[1:])
        yield {"bodies": model, "robots": 16, "x real time, best": speeds[-1], "worst": speeds[0]}
