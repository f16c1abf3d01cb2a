"""A robot in ROS 2 of another make is the body of an agent: it is moved by cmd_vel, and its odometry and scans are what the agent knows."""

import json
import math
import signal
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from protocol import live
from protocol.endpoints import free_port
from protocol.messages import Observation
from protocol.node import Alive
from protocol.settings import NetworkSettings
from tests.live.harness import BOUND, Covey, Journal, rows

pytestmark = [pytest.mark.live, pytest.mark.slow]
ORIGIN = (20.0, 15.0, 1.2)  # of the odometry's frame in the arena
RATE = 1.0


@pytest.fixture
def router() -> Iterator[int]:
    """The port of a Zenoh router, in the place of rmw_zenohd."""
    port = free_port()
    session = live.open_session(NetworkSettings(mode="router", listen=(f"tcp/127.0.0.1:{port}",)))
    yield port
    session.close()


def robot(covey: Covey, port: int) -> tuple[subprocess.Popen[str], Path]:
    """The robot of s3 as a process, and the file of what it has heard."""
    folder = covey.folder / "robot"
    folder.mkdir()
    config = covey.runs / "latest" / "run.toml"
    words = [str(config), "s3", str(port), str(folder), *map(str, ORIGIN)]
    return covey.start(*words, module="tests.live.ros_partner"), folder / "heard.json"


def heard(file: Path) -> dict[str, Any]:
    """What the robot has heard so far."""
    return json.loads(file.read_text()) if file.exists() else {}


def until(file: Path, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """What the robot has heard once that fulfils the condition."""
    end = time.monotonic() + BOUND
    while time.monotonic() < end:
        data = heard(file)
        if data and condition(data):
            return data
        time.sleep(0.05)
    raise AssertionError(f"not reached: {heard(file)}")


def test_a_body_that_is_driven_by_odometry_and_cmd_vel_alone_takes_part_in_a_live_swarm(covey: Covey, router: int) -> None:
    """The robot takes the place of the body s3, drives where its agent sends it, and is seen and believed where it is."""
    covey.start(
        "up", "quick", "--bodies", "own", "--rate", str(RATE), "--seconds", "1000", "--record", "--set", f"bodies.epoch={time.time() + 8.0}"
    )
    covey.running()
    partner, file = robot(covey, router)
    words = ("bridge", "--agent", "s3", "--router", f"tcp/127.0.0.1:{router}", "--origin", *map(str, ORIGIN))
    bridge = covey.start(*words)
    replaced = covey.wait(lambda data: rows(data)["s3.body"]["state"] == "dead")
    assert rows(replaced)["s3.body"]["end"] == "exit code 3: a younger process of this name has taken over"
    begun = replaced["swarm"]["tick"]
    until(file, lambda data: data["cells"] > 4 and data["targets"] > 4 and math.dist(data["pose"][:2], (3.0, 2.0)) > 1.0)
    covey.wait(lambda data: data["swarm"]["tick"] >= begun + 24)
    found = covey.wait(lambda data: data["swarm"]["ospa"] < 1.0)["swarm"]["tick"]  # when depends on the search
    covey.wait(lambda data: data["swarm"]["tick"] >= found + 12)
    assert partner.poll() is None and bridge.poll() is None, (bridge.stderr, partner.stderr)

    assert covey.run("halt")[0] == 0
    halted = heard(file)
    time.sleep(1.0)
    assert math.dist(heard(file)["pose"][:2], halted["pose"][:2]) < 0.02, "a halted robot stands"
    assert covey.run("release")[0] == 0
    until(file, lambda data: math.dist(data["pose"][:2], halted["pose"][:2]) > 0.3)

    assert covey.run("kill", "s3")[0] == 0
    killed = time.monotonic()
    covey.wait(lambda data: not rows(data)["s3"]["alive"])
    time.sleep(max(0.0, killed + 1.0 - time.monotonic()))
    stood = heard(file)["pose"]
    time.sleep(1.0)
    assert math.dist(heard(file)["pose"][:2], stood[:2]) < 0.02, "without its agent the robot stands"
    said = heard(file)
    bridge.send_signal(signal.SIGTERM)
    assert bridge.wait(timeout=20.0) == 0, bridge.stderr
    assert covey.run("down")[0] == 0

    journal = Journal(covey)
    taken = max(journal.tokens(Alive, "s3"))[0]
    seen = [message for _, message in journal.said(Observation, taken) if message.recipient == "s3"]
    assert len(seen) > 20
    assert seen[-1].pose == pytest.approx([*said["at"][:2], math.remainder(said["at"][2], math.tau)], abs=0.02)
    assert statistics.median(score.hole for score in journal.after(begun + 2)[:24]) <= 1e-6
    assert statistics.median(score.ospa for score in journal.after(found)[:12]) < 1.0
