"""`covey study`: names, options and help. Imports little: it is read before every command."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from deploy.cli.options import FLAG, WHOLE


def study(
    name: str,
    /,
    *,
    quick: Annotated[bool, FLAG] = False,
    trials: Annotated[int | None, WHOLE] = None,
    seed: Annotated[int | None, WHOLE] = None,
    teams: str | None = None,
    targets: str | None = None,
    methods: str | None = None,
    faults: str | None = None,
    triple: str | None = None,
    capacity: str | None = None,
    dt: float | None = None,
    seconds: float | None = None,
    settings: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
    into: Path | None = None,
    workers: Annotated[int | None, WHOLE] = None,
    scheduler: str | None = None,
    json: Annotated[bool, FLAG] = False,
) -> int:
    """Run a study of the paper, or the robustness study.

    Name: convergence (IV-A), efficacy (IV-B, figure 4), heterogeneity (IV-C, figure 5), or robustness.
    Every method gets the same seeds. What is finished is kept: after Ctrl-C the same command goes on.
    robustness: OSPA around a fault (10 to 90 % killed; loss; delay; partitions), against no fault and a fresh team of the survivors.

    Parameters
    ----------
    quick
        Few short trials: under 3 minutes on 2 cores.
    trials
        Seeds for each combination of team, number of targets and method; the paper's size is 10.
    seed
        The first seed; the others follow it.
    teams
        Teams or compositions with commas between them; inside a composition use +, as in 20E+4H.
    targets
        Numbers of targets at the start, with commas.
    methods
        With commas: power, voronoi, voronoi-cod, pursuit, uniform-density, random, static.
    faults
        Of robustness, with commas: kill, loss, delay, partition; default: all.
    triple
        The three sensor classes of teams 2 to 5.
    capacity
        literal, expected, static or saturating.
    dt
        World time between two ticks, s.
    seconds
        World time of a trial, s.
    settings
        Any setting of the scenario: section.key=value. May be repeated.
    into
        The folder of the study; default: runs/study-NAME.
    workers
        Processes; default: one for each core.
    scheduler
        Address of a dask.distributed scheduler, such as tcp://host:8786: its workers run the trials.
    json
        The last line of standard output is the table as one JSON object.
    """
    from deploy.extras import need

    need("study")
    from deploy.cli import study as studying
    from protocol.settings import BadSetting

    if name == "robustness":
        from deploy.cli import robustness as robust

        fixed = {**studying.options_of(triple, capacity, dt, seconds, settings or []), **robust.settings_of(teams, targets, methods)}
        return robust.study(quick, trials, seed, faults, fixed, into or studying.default_folder(name, quick), workers, scheduler, json)
    if faults is not None:
        raise BadSetting(f"--faults {faults}: an option of the robustness study alone")
    options = studying.options_of(triple, capacity, dt, seconds, settings or [])
    given = studying.given(trials, seed, teams, targets, methods)
    found = studying.chosen(name, quick, given, options)
    return studying.study(found, into or studying.default_folder(name, quick), workers, scheduler, json)
