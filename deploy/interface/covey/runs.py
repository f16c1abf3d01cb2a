"""Runs: a scenario with options laid over it, its simulation, and what came out, tick by tick."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from covey.arguments import checked
from covey.columns import Columns, columns_of, to_arrow, to_pandas
from covey.plugged import name_of, name_of_law
from deploy.cli.options import RunOptions
from deploy.scenario import Scenario, toml_text
from deploy.scoring.result import Result
from deploy.scoring.scores import Score
from protocol.observer_messages import Truth
from protocol.settings import BadOption, BadSetting

if TYPE_CHECKING:
    import pandas
    import pyarrow

Partition = Literal["power", "voronoi", "voronoi-cod"]
Capacity = Literal["literal", "expected", "static", "saturating"]


@checked
def scenario(
    name: str | Path | Scenario = "convergence",
    *,
    seed: int | None = None,
    seconds: float | None = None,
    dt: float | None = None,
    team: str | None = None,
    triple: str | None = None,
    targets: int | None = None,
    data: str | Path | None = None,
    partition: Partition | None = None,
    capacity: Capacity | None = None,
    control: object | None = None,
    sensors: Mapping[str, object] | None = None,
    kill: str | Sequence[str] = (),
    loss: float | None = None,
    delay: float | None = None,
    rate: float | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Scenario:
    """A scenario with options laid over it; raises BadSetting naming what is wrong.

    Parameters
    ----------
    name
        A scenario that is shipped (convergence, efficacy, heterogeneity, quick, anisotropic), a TOML file, or a Scenario.
    seed
        The same scenario and seed give the same run.
    seconds, dt
        World time of the run and between two ticks, s.
    team
        A team of the paper ("1" to "8"), or a composition such as "20E+4H".
    triple
        The three sensor classes of teams 2 to 5, such as "ACD".
    targets
        Number of targets at the start.
    data
        The files of a recorded world: a file, or the folder of mrclam.
    partition, capacity
        How the arena is divided, and how a sensor's capacity is reckoned.
    control
        lloyd, static, random, uniform-density, pursuit, search-and-track; or your own: a class without arguments, an object of which
        each agent gets a copy, or "module:Class".
    sensors
        Your own sensor classes by name: a class without arguments, an object that all agents share, or "module:Class". `team` names
        them.
    kill
        Agents to kill at a world time: "30%@300", "4@100", "s3,s4@50".
    loss, delay
        Share of the messages between agents that is lost, and how many s they are late.
    rate
        World seconds per second, without waiting for late agents; default: lockstep; a Scenario keeps its own clock.
    settings
        Any setting by its dotted name, such as {"detection.clutter": 0.5}. Your own motions and platforms are named here, as texts
        "module:Class".
    """
    named: dict[str, Any] = {f"sensors.{key}.model": name_of(sensor) for key, sensor in (sensors or {}).items()}
    named |= settings or {}
    options = RunOptions(
        seed=seed,
        team=team,
        triple=triple,
        targets=targets,
        data=None if data is None else Path(data),
        partition=partition,
        capacity=capacity,
        control=None if control is None else name_of_law(control),
        dt=dt,
        seconds=seconds,
        kill=[kill] if isinstance(kill, str) else list(kill),
        loss=loss,
        delay=delay,
        lockstep=rate is None and not isinstance(name, Scenario),
        rate=rate,
    )
    if not isinstance(name, Scenario):
        return options.scenario(str(name), named)
    return _lay_over(name, options, named)


def _lay_over(found: Scenario, options: RunOptions, settings: Mapping[str, Any]) -> Scenario:
    """Options over a scenario that is resolved already: it goes the way of a file."""
    data = msgspec.to_builtins(found)
    if options.team is not None or (options.triple is not None and found.team.composition):
        del data["members"]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.toml"
        file.write_text(toml_text(data), encoding="utf-8")
        try:
            return options.scenario(str(file), settings)
        except BadOption:
            raise
        except BadSetting as error:
            raise BadSetting(str(error).replace(str(file), f"scenario {found.run.scenario}")) from None


@dataclass(frozen=True, repr=False, eq=False)
class Run:
    """What came out of a run. Every array has one row for each tick that was scored; lengths in m, areas as shares of the arena."""

    scenario: Scenario  # with its options
    result: Result  # the figures of the whole run: fields in docs/reference/results.md#the-fields-of-a-result
    agents: tuple[str, ...]  # names, in the order of the columns of `poses`
    poses: np.ndarray  # (ticks, agents, 3): x, y, heading of every body; nan where there is none
    true_targets: tuple[np.ndarray, ...]  # (targets, 2) at each tick
    scores: tuple[Score, ...] = field(repr=False)

    @property
    def tick(self) -> np.ndarray:
        """Number of the tick."""
        return self._series("tick")

    @property
    def time(self) -> np.ndarray:
        """World time, s."""
        return self._series("time")

    @property
    def ospa(self) -> np.ndarray:
        """OSPA distance between the targets and what the agents report, m."""
        return self._series("ospa")

    @property
    def gospa(self) -> np.ndarray:
        """GOSPA distance, m: `localisation` + `missed` + `false`, each of them a column."""
        return self._series("gospa")

    @property
    def targets(self) -> np.ndarray:
        """Number of targets."""
        return self._series("targets")

    @property
    def in_view(self) -> np.ndarray:
        """Number of targets inside some field of view."""
        return self._series("in_view")

    @property
    def estimated(self) -> np.ndarray:
        """Number of targets that the agents report."""
        return self._series("estimated")

    @property
    def mass(self) -> np.ndarray:
        """Expected number of targets, summed over the agents."""
        return self._series("mass")

    def columns(self) -> Columns:
        """All series, under the names of docs/reference/results.md#the-columns-of-scorescsv"""
        return columns_of(asdict(score) for score in self.scores)

    def to_pandas(self) -> "pandas.DataFrame":
        """The columns as a pandas.DataFrame; raises ImportError where pandas is not installed."""
        return to_pandas(self.columns())

    def to_arrow(self) -> "pyarrow.Table":
        """The columns as a pyarrow.Table; raises ImportError where pyarrow is not installed."""
        return to_arrow(self.columns())

    def _series(self, name: str) -> np.ndarray:
        return np.array([getattr(score, name) for score in self.scores])

    def __len__(self) -> int:
        return len(self.scores)

    def __repr__(self) -> str:
        result = self.result
        ospa = f"OSPA {result.mean_ospa:.2f} m mean, {result.steady_ospa:.2f} m steady, {result.final_ospa:.2f} m at the end"
        ospa = ospa if result.has_targets else "OSPA -"
        return f"<Run of {result.scenario}, seed {result.seed}: {result.agents} agents, {result.ticks} ticks of {result.dt:g} s; {ospa}>"


@checked
def simulate(
    name: str | Path | Scenario = "convergence",
    *,
    seed: int | None = None,
    seconds: float | None = None,
    dt: float | None = None,
    team: str | None = None,
    triple: str | None = None,
    targets: int | None = None,
    data: str | Path | None = None,
    partition: Partition | None = None,
    capacity: Capacity | None = None,
    control: object | None = None,
    sensors: Mapping[str, object] | None = None,
    kill: str | Sequence[str] = (),
    loss: float | None = None,
    delay: float | None = None,
    rate: float | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Run:
    """Run a scenario in this process, in virtual time; the options are those of `scenario`.

    `progress` is called with the share of the ticks that are done. Standard error names faults that change nothing. Raises BadSetting
    naming what is wrong.
    """
    from deploy.cli.errors import tell_remarks
    from deploy.cli.scenario_checks import simulation_remarks
    from deploy.simulation import Simulation, compile_once

    found = scenario(
        name,
        seed=seed,
        seconds=seconds,
        dt=dt,
        team=team,
        triple=triple,
        targets=targets,
        data=data,
        partition=partition,
        capacity=capacity,
        control=control,
        sensors=sensors,
        kill=kill,
        loss=loss,
        delay=delay,
        rate=rate,
        settings=settings,
    )
    tell_remarks(simulation_remarks(found, found.run.clock))
    compile_once()
    simulation = Simulation(found, clock=found.run.clock)
    truths: dict[int, Truth] = {}

    def heard(truth: Truth) -> None:
        truths[truth.tick] = truth
        progress((truth.tick + 1) / found.run.ticks)

    simulation.on_truth = heard
    return _run_of(found, simulation.run(), simulation.scorer.scores, truths)


@checked
def load(name: str | Path) -> Run:
    """A recorded run: the name of a run, its directory, or a recording (.mcap); scored again from what was heard."""
    from deploy.recording.recording import Recording, find_recording
    from deploy.recording.rescore import rescore_slowly
    from deploy.scoring.scorer import Scorer

    recording = Recording(find_recording(str(name)))
    scorer = Scorer(recording.scenario, recorded=True)
    truths: dict[int, Truth] = {}
    scorer.on_truth = lambda truth: truths.update({truth.tick: truth})
    for _ in rescore_slowly(recording, scorer):
        pass
    return _run_of(recording.scenario, scorer.result(recording.wall_seconds), scorer.scores, truths)


def _run_of(found: Scenario, result: Result, scores: Sequence[Score], truths: Mapping[int, Truth]) -> Run:
    agents = tuple(found.members)
    poses = np.full((len(scores), len(agents), 3), np.nan)
    places = {name: place for place, name in enumerate(agents)}
    for row, score in enumerate(scores):
        truth = truths[score.tick]
        for name, pose in zip(truth.bodies, truth.poses):
            if name in places:
                poses[row, places[name]] = pose
    return Run(found, result, agents, poses, tuple(truths[score.tick].targets for score in scores), tuple(scores))
