"""Designs: what a study compares, and the trials that follow from it, all methods with the same seeds."""

import itertools
from typing import Any

import msgspec

from deploy.scenario import TeamSettings, check_triple, team_counts
from deploy.studies.trials import ABLATIONS, Trial, check_free, check_method, check_scored, check_seeds, settings_of
from protocol.settings import BadOption, BadSetting


class Design(msgspec.Struct, frozen=True, kw_only=True):
    """What a study compares: all combinations of teams, numbers of targets and methods, each with the same seeds."""

    scenario: str
    teams: tuple[str, ...]
    targets: tuple[int, ...]
    methods: tuple[str, ...]  # of METHODS, or control laws `module:Class`
    trials: int = 10
    first_seed: int = 100  # of the seeds 100, 101, ...; the defaults of the scenarios were found with smaller ones
    options: dict[str, Any] = {}  # dotted settings of all trials
    elsewhere: dict[str, tuple[str, int]] = {}  # teams of another scenario, with its name and number of targets


OPEN_TEAMS = {  # the teams of sections IV-B and IV-C that the ablation compares, by composition
    "5A+20B+15C": "4 ABC",
    "3A+12B+9C": "2 ABC",
    "5A+20C+15D": "4 ACD",
    "3A+12C+9D": "2 ACD",
    "20E+20F": "20E+20F",
    "20E+10G": "20E+10G",
    "20E+4H": "20E+4H",
}
STUDIES: dict[str, Design] = {
    "convergence": Design(scenario="convergence", teams=("1",), targets=(8,), methods=("power", "voronoi-cod", "voronoi", "static")),
    "efficacy": Design(scenario="efficacy", teams=("2", "3", "4", "5"), targets=(30, 40, 50), methods=("power", "voronoi", "voronoi-cod")),
    "heterogeneity": Design(
        scenario="heterogeneity", teams=("20E+20F", "20E+10G", "20E+4H"), targets=(30,), methods=("power", "voronoi", "voronoi-cod")
    ),
    "ablation": Design(
        scenario="efficacy",
        teams=(*OPEN_TEAMS, "1"),
        targets=(30,),
        methods=("search-and-track", "power", "power-extraction", "voronoi", "pursuit", "static", "random", "oracle", *ABLATIONS),
        first_seed=400,
        options={"run.dt": 0.25, "run.seconds": 1000.0},
        elsewhere={"1": ("convergence", 8)},
    ),
}
OWN_OPTIONS = {  # of a study, by the settings of its trials
    "run.seed": "seed",
    "team.composition": "teams",
    "targets.count": "targets",
    "partition.kind": "methods",
    "control.mode": "methods",  # rows bear the name of their law
}
QUICK: dict[str, dict[str, Any]] = {  # what --quick lays over a study: under 3 minutes on 2 cores
    "convergence": {"trials": 4, "options": {"run.dt": 0.5}},
    "efficacy": {"trials": 3, "options": {"run.dt": 0.5, "run.seconds": 40.0}},
    "heterogeneity": {"trials": 4, "options": {"run.dt": 0.5, "run.seconds": 80.0}},
    "ablation": {
        "trials": 2,
        "teams": ("20E+4H", "1"),
        "methods": ("search-and-track", "power", "pursuit", "no-search", "no-distance"),
        "options": {"run.dt": 0.25, "run.seconds": 60.0},
    },
}


def design(name: str, quick: bool = False) -> Design:
    """The study of that name; raises BadSetting listing what there is."""
    if name not in STUDIES:
        raise BadSetting(f"study {name!r} does not exist; known are {', '.join(STUDIES)}, robustness, bodies")
    return msgspec.structs.replace(STUDIES[name], **QUICK[name]) if quick else STUDIES[name]


def plan(found: Design) -> list[Trial]:
    """All trials, seed by seed, so that a study that is cut short has compared everything equally often; checked by resolving them."""
    for name in found.methods:
        check_method(name)
    by_all = set.intersection(*(set(settings_of(name)) for name in found.methods))
    check_free(found.options, dict.fromkeys(by_all, "methods") | OWN_OPTIONS)
    for team in found.teams:
        check_triple(team, found.options.get("team.triple"))
        team_counts(TeamSettings(composition=team, triple=found.options.get("team.triple", "ACD")))
    check_seeds(found.first_seed, found.trials)
    seeds = range(found.first_seed, found.first_seed + found.trials)
    trials = [
        _trial(found, seed, targets, team, method)
        for seed, targets, team, method in itertools.product(seeds, found.targets, found.teams, found.methods)
        if team not in found.elsewhere or targets == found.targets[0]  # such a team has its own number of targets
    ]
    for trial in trials[: len(found.targets) * len(found.teams) * len(found.methods)]:
        check_scored(trial.resolve())
    return trials


def _trial(found: Design, seed: int, targets: int, team: str, method: str) -> Trial:
    """One trial; a team of another scenario plays that scenario with its number of targets."""
    scenario, count = found.elsewhere.get(team, (found.scenario, targets))
    return Trial(scenario=scenario, seed=seed, team=team, targets=count, method=method, options=found.options)


def design_fields(trials: int | None, seed: int | None, teams: str | None, targets: str | None, methods: str | None) -> dict[str, Any]:
    """The fields of a design that the command line names; raises BadOption."""
    if trials is not None and trials < 1:
        raise BadOption("trials", trials, "should be at least 1")
    numbers = _parts(targets)
    if numbers is not None and not all(part.isdecimal() for part in numbers):
        raise BadOption("targets", targets, "should be whole numbers with commas, such as 30,40,50")
    counts = None if numbers is None else tuple(map(int, numbers))
    named = {"trials": trials, "first_seed": seed, "teams": _parts(teams), "targets": counts, "methods": _parts(methods)}
    return {field: value for field, value in named.items() if value is not None}


def check_workers(workers: int | None) -> None:
    """Raise BadOption for a number of worker processes that is none."""
    if workers is not None and workers < 1:
        raise BadOption("workers", workers, "should be 1 or more")


def _parts(text: str | None) -> tuple[str, ...] | None:
    """The words between commas, each once."""
    return None if text is None else tuple(dict.fromkeys(part.strip() for part in text.split(",")))


def dotted_options(triple: str | None, capacity: str | None, dt: float | None, seconds: float | None) -> dict[str, Any]:
    """The dotted settings that have an option of their own."""
    named = {"team.triple": triple, "capacity.mode": capacity, "run.dt": dt, "run.seconds": seconds}
    return {dotted: value for dotted, value in named.items() if value is not None}


def design_with(name: str, quick: bool, fields: dict[str, Any], options: dict[str, Any]) -> Design:
    """A study with the options of the command line laid over it."""
    found = design(name, quick)
    return msgspec.structs.replace(found, **fields, options={**found.options, **options})
