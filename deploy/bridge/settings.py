"""What the bridge reads of a run.toml, and its options."""

import math
import re
import sys
import time
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from deploy.bridge.body import Rules
from deploy.bridge.client import Network
from deploy.bridge.frames import Placement
from deploy.bridge.ros import ROUTER

ROUTER_FORM = r"(tcp|tls|udp|quic|ws)/[^\s?#]+:\d{1,5}([?#]\S+)?"  # Zenoh dials any other in vain, or ends


class Wrong(Exception):
    """An input that cannot be used, in one line."""


class BridgeOptions(NamedTuple):
    """Of one bridge."""

    config: Path
    agent: str
    router: str = ROUTER
    domain: int = 0
    offset: float = 0.0  # m from the axle of a differential drive to its sensor; 0: it moves in any direction
    origin: Placement = (0.0, 0.0, 0.0)  # of the odometry's frame in the arena's: x m, y m, heading rad
    keep: Path | None = None  # file of the newest halt


def read_run(options: BridgeOptions) -> tuple[str, Network, Rules]:
    """The name of the run, how it is reached and the rules of the body; raises Wrong."""
    file, agent = options.config, options.agent
    try:
        data = tomllib.loads(file.read_text(encoding="utf-8"))
        return _run(data, agent)
    except OSError as error:
        raise Wrong(f"--config {file}: {error.strerror}") from None
    except (KeyError, TypeError, ValueError) as error:
        why = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise Wrong(f"--config {file}: {why}; should be a run.toml with all settings, as `covey config` prints it") from None


def _run(data: dict[str, Any], agent: str) -> tuple[str, Network, Rules]:
    run, bodies, arena, limits, network, members = (data[key] for key in ("run", "bodies", "arena", "limits", "network", "members"))
    if agent not in members:
        raise Wrong(f"--agent {agent}: the run has no such agent; it has {', '.join(members)}")
    sensor = data["sensors"].get(members[agent], {})
    if (measures := sensor.get("measures", "position")) != "position":
        raise Wrong(f"sensors.{members[agent]}.measures = {measures!r}: a robot reports places here; should be 'position'")
    if run["clock"] != "realtime":
        raise Wrong(f"run.clock = {run['clock']!r}: a robot cannot wait; should be 'realtime'")
    fence, epoch, lasts, most = bodies.get("fence"), bodies["epoch"], run["seconds"] / run["rate"], run["start_timeout"]
    if epoch and epoch + lasts <= time.time():
        over = f"by this machine's clock the run of {lasts:g} s is over"
        raise Wrong(f"bodies.epoch = {epoch:.3f}: {over}; should be 0, or more than {time.time() - lasts:.0f}: is the clock right?")
    if epoch > time.time() + most:
        ahead = f"lies {epoch - time.time():.0f} s ahead of this machine's clock"
        raise Wrong(f"bodies.epoch = {epoch:.3f}: {ahead}; should be at most {most:g} s (run.start_timeout): is the clock right?")
    if data["targets"]["count"]:
        others = "scores and the rings of the page are those of simulated targets"
        print(f"bridge: targets.count = {data['targets']['count']}: {others}; should be 0 where detections are real", file=sys.stderr)
    rules = Rules(
        agent=agent,
        expected=tuple(members),
        dt=run["dt"],
        period=run["dt"] / run["rate"],
        anchor=epoch - time.time() + time.monotonic() if epoch else None,
        patience=run["start_timeout"],
        strict=run["strict"],
        hold=bodies["hold"],
        speed=limits["speed"],
        turn_rate=limits["turn_rate"],
        ticks=max(1, round(run["seconds"] / run["dt"])),
        reach=sensor.get("radius", math.inf),
        sight=2.0 * limits["radius"] + 8.0 * limits["speed"] * run["dt"] if limits["radius"] else 0.0,
        box=None if fence is None else (-fence, -fence, arena["width"] + fence, arena["height"] + fence),
    )
    files = {field: network[field].replace("{name}", agent) for field in ("ca", "certificate", "key")}
    listen = tuple(network["listen"])
    if files["ca"]:
        listen = tuple(endpoint.replace("tcp/", "tls/") for endpoint in listen)
    if network["mode"] not in ("peer", "client"):
        raise Wrong(f"network.mode = {network['mode']!r}: a bridge passes nothing on; should be 'peer' or 'client'")
    if files["ca"] and network["mode"] != "peer":
        raise Wrong(f"network.mode = {network['mode']!r}: behind a router no certificate says who speaks; should be 'peer'")
    admitted = tuple(network["admit"]) or tuple(members)
    reached = Network(tuple(network["seeds"]), listen, **files, admitted=admitted, mode=network["mode"], lease=float(network["lease"]))
    return run["name"], reached, rules


def check(options: BridgeOptions) -> None:
    """Raise Wrong for an option that cannot be."""
    if not 0.0 <= options.offset <= 10.0:
        raise Wrong(f"--offset {options.offset}: should be from 0 to 10 m")
    if not all(map(math.isfinite, options.origin)):
        raise Wrong(f"--origin {options.origin}: should be three finite numbers x m, y m, heading rad")
    if not re.fullmatch(ROUTER_FORM, options.router):
        raise Wrong(f"--router {options.router!r}: should be an endpoint such as tcp/192.168.1.7:7447")
    if not 0 <= options.domain <= 232:
        raise Wrong(f"--domain {options.domain}: should be a ROS_DOMAIN_ID from 0 to 232")
