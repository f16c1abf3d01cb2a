"""`init`, `check`, `platform` and `config`: commands on scenario files."""

import math
import os
import shlex
import shutil
import sys
from pathlib import Path

from deploy.cli.message_text import printable
from deploy.cli.scenario_checks import (
    check_platform_class,
    fault_remarks,
    faults_beyond_a_simulation,
    faults_on_links,
    faults_that_are_waited_for,
    interest_remarks,
    scale_remarks,
    team_remarks,
)
from deploy.cli.template import template
from deploy.installation import versions
from deploy.scenario import ORACLE, Scenario, agent_config, recording_remarks, targets_in_words, toml_text, world_config
from deploy.scoring.tick_rate import too_small
from deploy.storage.run_directory import LEAST_BYTES, runs_folder
from protocol.settings import BadSetting, NetworkSettings
from world.bodies import pose_warnings


def init(file: Path) -> int:
    """Write a scenario with every section and every default; raises BadSetting when the file exists or cannot be written."""
    if file.suffix != ".toml":
        raise BadSetting(f"{file}: should be a file that ends in .toml")
    try:
        out = file.open("x", encoding="utf-8")
    except FileExistsError:
        raise BadSetting(f"{file}: exists and is left as it is; give another name") from None
    except OSError as error:
        raise BadSetting(f"{file}: {error.strerror}") from None
    try:
        with out:
            out.write(template())
    except OSError as error:
        file.unlink()  # a partial scenario is not left behind
        raise BadSetting(f"{file}: {error.strerror}") from None
    word = shlex.quote(str(file))
    print(f"{file}: every section and every default; change it, then: covey check {word}; covey up {word}")
    return 0


def try_platform(scenario: Scenario, agent: str) -> int:
    """Try the platform of an agent's body and print which rules of the contract it keeps; 1 when one is broken."""
    from deploy.live.platform_check import check_and_print

    if agent not in scenario.members:
        raise BadSetting(f"platform: {agent}: the scenario has no such agent; it has {', '.join(scenario.members)}")
    return check_and_print(agent, world_config(scenario))


def config(scenario: Scenario, agents: bool) -> int:
    """Print a resolved scenario as TOML, or the part of it that its agents may know."""
    print(toml_text(agent_config(scenario) if agents else scenario), end="")
    return 0


def check_network_and_print(scenario: Scenario, name: str) -> int:
    """Print what is found on the network of a scenario with the certificate of `name`; 1 when something is wrong."""
    from deploy.live.network_check import check_network

    wrong = 0
    for right, text in check_network(scenario, name):
        print(f"{'ok    ' if right else 'WRONG '} {printable(text)}", flush=True)
        wrong += not right
    return 1 if wrong else 0


def print_mistakes(lines: list[str]) -> int:
    """Print all mistakes of a scenario; the exit code."""
    for line in lines:
        print(f"covey: {line}", file=sys.stderr)
    return 2


def check(scenario: Scenario) -> int:
    """Print a summary; raises BadSetting where this machine has no platform of the bodies, or opens no session.

    Certificates may lie on another machine, for which the scenario is meant.
    """
    from protocol.endpoints import check_loopback
    from protocol.live import open_session  # loads zenoh

    platform_remark = check_platform_class(scenario)
    classes = list(scenario.members.values())
    team = ", ".join(f"{classes.count(name)} {name}" for name in dict.fromkeys(classes))
    run = scenario.run
    print(f"scenario   {run.scenario} is right: {len(classes)} agent{'s' * (len(classes) != 1)} ({team})")
    print(f"           {targets_in_words(scenario)}, {run.ticks} ticks of {run.dt:g} s")
    if not math.isclose(run.ticks * run.dt, run.seconds):
        print(f"           run.seconds = {run.seconds:g} is no multiple of run.dt: the run lasts {run.ticks * run.dt:g} s")
    for remark in filter(None, (platform_remark, *pose_warnings(world_config(scenario)))):
        print(f"bodies     {remark}")
    for remark in team_remarks(scenario):
        print(f"team       {remark}")
    for remark in (*scale_remarks(scenario), *interest_remarks(scenario)):
        print(f"fit        {remark}")
    if scenario.control.mode == ORACLE:
        print("control    oracle knows the true targets: of `covey simulate` alone, `covey up` refuses it")
    tell_certificates(scenario)
    found = versions()
    for remark in recording_remarks(scenario):
        print(f"left out   {remark}")
    print(f"machine    Python {found['python']}, {found['cores']} cores, {found['machine']}")
    check_loopback()
    open_session(NetworkSettings()).close()
    print(f"network    a Zenoh {found['packages']['eclipse-zenoh']} session opens on 127.0.0.1")
    folder = next(path for path in [runs_folder(), *runs_folder().parents] if path.exists())
    if not os.access(folder, os.W_OK) or not folder.is_dir():
        raise BadSetting(f"runs {runs_folder()}: cannot be written; COVEY_RUNS names another place")
    if shutil.disk_usage(folder).free < LEAST_BYTES:
        raise BadSetting(f"runs {runs_folder()}: the disk is full; COVEY_RUNS names another place")
    print(f"runs       {runs_folder()}: writable")
    elsewhere = faults_that_are_waited_for(scenario), faults_on_links(scenario), faults_beyond_a_simulation(scenario)
    for remark in filter(None, (*fault_remarks(scenario), *elsewhere)):
        print(f"faults     {remark}")
    if advice := too_small(scenario):
        print(f"warning    {advice}", file=sys.stderr)
    return 0


def tell_certificates(scenario: Scenario) -> None:
    """Print what is wrong with the certificates of this machine; those of other machines may be there alone."""
    from deploy.live.startup import check_certificates  # `config` has no use for what it loads

    try:
        check_certificates(scenario)
    except BadSetting as error:
        print(f"missing    {error}. `covey up` needs it on the machine where it runs")
