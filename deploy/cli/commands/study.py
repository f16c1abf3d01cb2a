"""Commands that study and measure: names, options and help."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from deploy.cli import completion
from deploy.cli.app import STUDY, app
from deploy.cli.options import FLAG, WHOLE


@app.command(group=STUDY, help_epilogue="Example: covey study efficacy --quick")
def study(
    name: Annotated[str, Parameter(completer=completion.studies)],
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
    """Run a study of the paper, of robustness, or of bodies.

    Name: convergence (IV-A), efficacy (IV-B, figure 4), heterogeneity (IV-C, figure 5), ablation, robustness, or bodies.
    Every method gets the same seeds. What is finished is kept: after Ctrl-C the same command goes on.
    ablation: search-and-track without each of its ingredients, and beside other methods; OSPA and GOSPA with their parts.
    robustness: OSPA around a fault (10 to 90 % killed; loss; bursts; delay; little bandwidth; partitions), against no fault and a
    fresh team of the survivors.
    bodies: do bodies with a size touch when agents die, and what does their size cost? 200 seeds x 300 s.

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
        With commas: power, voronoi, voronoi-cod, pursuit, search-and-track, uniform-density, random, static, those of the ablation,
        and control laws of your own as module:Class. The first is compared with each of the others.
        Of bodies: points, radius, mujoco.
    faults
        Of robustness, with commas: kill, loss, bursts, delay, throttle, partition; default: all.
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
        The last line of standard output is the table as one JSON object, with the comparisons on the same seeds in `pairs`.
    """
    from deploy.installation import need_study_packages

    need_study_packages("study")
    from deploy.cli.study import default_folder, run_study
    from deploy.scenario import parse_set
    from deploy.studies.design import check_workers, design_fields, design_with, dotted_options
    from protocol.settings import BadSetting

    check_workers(workers)
    options = {**dotted_options(triple, capacity, dt, seconds), **dict(map(parse_set, settings or []))}
    folder = into or default_folder(name, quick)
    if name == "robustness":
        from deploy.cli.robustness import run_robustness_study, settings_of

        fixed = {**options, **settings_of(teams, targets, methods)}
        return run_robustness_study(quick, trials, seed, faults, fixed, folder, workers, scheduler, json)
    if faults is not None:
        raise BadSetting(f"--faults {faults}: an option of the robustness study alone")
    if name == "bodies":
        from deploy.cli.bodies import run_body_study

        return run_body_study(quick, design_fields(trials, seed, teams, targets, methods), options, folder, workers, scheduler, json)
    design = design_with(name, quick, design_fields(trials, seed, teams, targets, methods), options)
    if name == "ablation":
        from deploy.cli.ablation import run_ablation_study

        return run_ablation_study(design, folder, workers, scheduler, json)
    return run_study(design, folder, workers, scheduler, json)


@app.command(group=STUDY, help_epilogue="Example: covey bench round")
def bench(
    what: Annotated[str, Parameter(completer=completion.benches)] = "all",
    /,
    *,
    json: Annotated[bool, FLAG] = False,
    seconds: float | None = None,
) -> int:
    """Measure this machine.

    What: round, simulate, live, realtime, tls, scale, start, codec, memory, peers, page, replay, overload, bodies, or all of them.
    --seconds: how long realtime runs each of its swarms; a minute if it is not given.
    """
    import os

    from deploy.installation import command, environment

    words = [what, *(["--json"] if json else []), *([f"--seconds={seconds:g}"] if seconds is not None else [])]
    program = [*command("deploy.bench"), *words]
    os.execve(program[0], program, environment())


@app.command(group=STUDY, help_epilogue="Example: covey fuzz --seeds 20")
def fuzz(
    *,
    seeds: Annotated[int, WHOLE] = 300,
    first: Annotated[int, WHOLE] = 1,
    jobs: Annotated[int | None, WHOLE] = None,
    profile: str = "mixed",
) -> int:
    """Small swarms under faults drawn from a seed, all invariants checked.

    Exit code 1 when a seed fails.
    --profile: mixed, late, radio or bursts; the last three are networks that are slow or bad.
    """
    from deploy.cli import fuzz

    return fuzz.fuzz(seeds, first, jobs, profile)
