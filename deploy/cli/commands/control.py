"""Commands that act on a running swarm: names, options and help."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from deploy.cli.app import ACT, AgentChoice, RandomCount, RunName, SwarmName, app
from deploy.cli.options import WHOLE


@app.command(group=ACT, help_epilogue="Example: covey down --run hunt")
def down(*, run: RunName = None) -> int:
    """End a running swarm, and wait until its result is written."""
    from deploy.cli.control import down

    return down(run)


@app.command(group=ACT, help_epilogue="Example: covey halt")
def halt(*, run: SwarmName = None) -> int:
    """Make all bodies stand where they are until they are released.

    The swarm goes on tracking. Under TLS this takes the certificate of the operator. Exit code 1: some body still moves after 5 s.
    """
    from deploy.cli.halt import say

    return say(run, held=True)


@app.command(group=ACT, help_epilogue="Example: covey release")
def release(*, run: SwarmName = None) -> int:
    """Let bodies that were halted move again."""
    from deploy.cli.halt import say

    return say(run, held=False)


@app.command(group=ACT, help_epilogue="Example: covey kill s1 s2 s3\n         covey kill 30%")
def kill(*who: AgentChoice, random: RandomCount = None, run: RunName = None) -> int:
    """Kill agents (SIGKILL)."""
    return _send("kill", who, random, run)


@app.command(group=ACT, help_epilogue="Example: covey pause s4 s7")
def pause(*who: AgentChoice, random: RandomCount = None, run: RunName = None) -> int:
    """Stop agents in their tracks (SIGSTOP)."""
    return _send("pause", who, random, run)


@app.command(group=ACT, help_epilogue="Example: covey resume s4")
def resume(*who: AgentChoice, random: RandomCount = None, run: RunName = None) -> int:
    """Let paused agents go on (SIGCONT); all of them unless said."""
    return _send("resume", who, random, run, "100%")


@app.command(group=ACT, help_epilogue="Example: covey restart s1 s2")
def restart(*who: AgentChoice, random: RandomCount = None, run: RunName = None) -> int:
    """Bring agents back under their names; all the dead unless said.

    One that is named and still lives is ended first.
    """
    return _send("restart", who, random, run, "100%")


@app.command(group=ACT, help_epilogue="Example: covey partition s1 s2 --kind one-way")
def partition(*who: AgentChoice, kind: Literal["both", "one-way", "bridge"] = "both", run: RunName = None) -> int:
    """Cut agents off from the rest of a swarm that allows it.

    The scenario has to say network.link_faults = true.
    """
    return _send("partition", who, None, run, options={"kind": kind})


@app.command(group=ACT, help_epilogue="Example: covey heal")
def heal(*, run: RunName = None) -> int:
    """Make all links clear again."""
    return _send("heal", (), None, run, "")


@app.command(group=ACT, help_epilogue="Example: covey drop 0.2 s1 s2 --burst 4")
def drop(share: float, /, *who: AgentChoice, burst: float = 0.0, run: RunName = None) -> int:
    """Lose a share (0 to 1) of the messages from and to agents.

    Of all agents unless said; --burst: in runs of so many. The scenario has to say network.link_faults = true.
    """
    return _send("drop", who, None, run, "", value=share, options={"burst": burst})


@app.command(group=ACT, help_epilogue="Example: covey delay 0.5 s3 --jitter 0.2")
def delay(seconds: float, /, *who: AgentChoice, jitter: float = 0.0, run: RunName = None) -> int:
    """Deliver the messages from and to agents so many seconds late.

    Of all agents unless said. The scenario has to say network.link_faults = true.
    """
    return _send("delay", who, None, run, "", value=seconds, options={"jitter": jitter})


@app.command(group=ACT, help_epilogue="Example: covey bridge --agent s3 --router tcp/127.0.0.1:7447")
def bridge(
    *,
    agent: str,
    run: SwarmName = None,
    router: str = "tcp/127.0.0.1:7447",
    domain: Annotated[int | None, WHOLE] = None,
    offset: float = 0.0,
    origin: Annotated[tuple[float, float, float], Parameter(negative="")] = (0.0, 0.0, 0.0),
    keep: Path | None = None,
) -> int:
    """Let a robot that speaks ROS 2 be the body of an agent.

    /s3/odom and /s3/detections in, /s3/cmd_vel out, by way of rmw_zenoh. --offset: m from the axle of a differential drive to its
    sensor. --origin: of the odometry's frame in the arena, x m, y m, heading rad. A body of this name that runs gives way.
    """
    from deploy.cli.bridge import bridge

    return bridge(agent, run, router, domain, offset, origin, keep)


def _send(
    verb: str,
    names: tuple[str, ...],
    random: int | None,
    run: str | None,
    otherwise: str | None = None,
    value: float | None = None,
    options: dict[str, str | float] | None = None,
) -> int:
    from deploy.cli import control

    return control.send(verb, control.selection(verb, names, random, otherwise), run, value, options)
