"""`bridge`: a robot that speaks ROS 2 becomes the body of an agent, in a process that shares nothing with this one."""

import os
import sys
from pathlib import Path

from deploy.cli.listener import swarm_to_watch
from deploy.installation import command, environment, need_packages


def bridge(
    agent: str, run: str | None, router: str, domain: int | None, offset: float, origin: tuple[float, float, float], keep: Path | None
) -> int:
    """Become the bridge of an agent of a run; raises BadSetting where the run or the package for ROS's messages is missing."""
    need_packages("bridge", ("rosbags",), "ros")
    directory, _ = swarm_to_watch(run, supervised=True)
    config = str(directory.config) if directory else str(run)
    place = [f"{number:.9f}" for number in origin]  # without exponents: argparse takes -1e-05 for an option
    words = ["--config", config, "--agent", agent, "--router", router, f"--offset={offset}", "--origin", *place]
    words += ["--domain", str(domain)] if domain is not None else []
    words += ["--keep", str(keep)] if keep else []
    sys.stdout.flush()
    program = [*command("deploy.bridge"), *words]
    os.execve(program[0], program, environment())
