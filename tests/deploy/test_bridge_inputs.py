"""What the bridge to ROS 2 is given: the run.toml of a swarm, its own options, and what is wrong with either, in one line."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.bridge.bridge import run
from deploy.bridge.client import config_of
from deploy.bridge.settings import BridgeOptions, Wrong, check, read_run
from deploy.scenario import resolve, toml_text
from protocol import live
from protocol.endpoints import free_port
from protocol.settings import NetworkSettings
from protocol.zenoh_settings import session_values

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def run_file(tmp_path: Path) -> Path:
    file = tmp_path / "run.toml"
    file.write_text(toml_text(resolve("quick", {"network.seeds": ["tcp/127.0.0.1:1"], "bodies.fence": 3.0})))
    return file


def test_the_run_file_of_a_swarm_says_all_that_a_body_must_know(run_file: Path) -> None:
    name, network, rules = read_run(BridgeOptions(run_file, "s3"))
    scenario = resolve("quick")
    assert (name, network.seeds, network.admitted) == (scenario.run.name, ("tcp/127.0.0.1:1",), tuple(scenario.members))
    assert (rules.dt, rules.period, rules.hold, rules.anchor) == (scenario.run.dt, scenario.run.dt / scenario.run.rate, 0.5, None)
    assert rules.box == (-3.0, -3.0, scenario.arena.width + 3.0, scenario.arena.height + 3.0)
    assert rules.ticks == scenario.run.ticks
    assert (rules.speed, rules.turn_rate, rules.reach) == (scenario.limits.speed, scenario.limits.turn_rate, math.inf)
    run_file.write_text(toml_text(resolve("quick", {"sensors.B.radius": 5.0})))
    assert read_run(BridgeOptions(run_file, "s3"))[2].reach == 5.0


@pytest.mark.parametrize("count", [0, 5])
def test_simulated_targets_beside_a_robot_are_remarked_on(count: int, run_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_file.write_text(toml_text(resolve("quick", {"targets.count": count})))
    read_run(BridgeOptions(run_file, "s3"))
    said = "targets.count = 5: scores and the rings of the page are those of simulated targets; should be 0 where detections are real"
    assert capsys.readouterr().err == (f"bridge: {said}\n" if count else "")


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_the_session_of_a_bridge_is_that_of_a_body_of_ours(mode: str, run_file: Path) -> None:
    wanted = {"network.seeds": ["tcp/127.0.0.1:1"], "network.mode": mode, "network.lease": 9.5}
    run_file.write_text(toml_text(scenario := resolve("quick", wanted)))
    _, network, _ = read_run(BridgeOptions(run_file, "s3"))
    session = config_of(network, "covey", "s3")
    for key, value in session_values(scenario.network).items():
        if not key.startswith(("transport/unicast/", "listen/exit")):  # of big swarms, and what is so anyway
            assert json.loads(session.get_json(key)) == json.loads(json.dumps(value)), key


def wrong_inputs(run_file: Path) -> Iterator[tuple[BridgeOptions, str]]:
    yield BridgeOptions(run_file, "s99"), "--agent s99: the run has no such agent; it has s1, s2"
    yield BridgeOptions(run_file.with_name("none.toml"), "s3"), "none.toml: No such file or directory"
    ranging = {"team.composition": "A3", "sensors.A.measures": "bearing", "sensors.A.bearing_noise": 2.0}
    (other := run_file.with_name("ranging.toml")).write_text(toml_text(resolve("quick", ranging)))
    yield BridgeOptions(other, "s3"), "sensors.A.measures = 'bearing': a robot reports places here; should be 'position'"
    (late := run_file.with_name("late.toml")).write_text(toml_text(resolve("quick", {"bodies.epoch": time.time() - 300.0})))
    yield BridgeOptions(late, "s3"), "s is over; should be 0, or more than"
    (early := run_file.with_name("early.toml")).write_text(toml_text(resolve("quick", {"bodies.epoch": time.time() + 4000.0})))
    yield BridgeOptions(early, "s3"), "s ahead of this machine's clock; should be at most 60 s (run.start_timeout)"
    yield BridgeOptions(run_file, "s3", offset=-1.0), "--offset -1.0: should be from 0 to 10 m"
    yield BridgeOptions(run_file, "s3", origin=(0.0, math.nan, 0.0)), "should be three finite numbers"
    for router in ("foo", "foo/bar:1", "tcp/127.0.0.1", "tcp/127.0.0.1:abc"):
        yield BridgeOptions(run_file, "s3", router=router), f"--router '{router}': should be an endpoint such as tcp/192.168.1.7:7447"
    yield BridgeOptions(run_file, "s3", domain=300), "--domain 300: should be a ROS_DOMAIN_ID from 0 to 232"


def test_wrong_input_is_one_line(run_file: Path) -> None:
    for options, complaint in wrong_inputs(run_file):
        with pytest.raises(Wrong) as error:
            check(options)
            read_run(options)
        assert complaint in str(error.value)
    whole, other = run_file.read_text(), run_file.with_name("other.toml")
    for mode, ca, complaint in (
        ("router", "", "should be 'peer' or 'client'"),
        ("client", "x", "behind a router no certificate says who speaks"),
    ):
        other.write_text(whole.replace('mode = "peer"', f'mode = "{mode}"').replace('ca = ""', f'ca = "{ca}"'))
        with pytest.raises(Wrong, match=complaint):
            read_run(BridgeOptions(other, "s3"))
    short = run_file.with_name("short.toml")
    short.write_text("[run]\nname = 'x'\n")
    with pytest.raises(Wrong, match=r"bodies is missing; should be a run\.toml with all settings"):
        read_run(BridgeOptions(short, "s3"))


def test_a_port_that_is_taken_and_a_certificate_that_is_missing_are_one_line(run_file: Path) -> None:
    taken = live.open_session(NetworkSettings(listen=(endpoint := f"tcp/127.0.0.1:{free_port()}",)))
    lost = {f"network.{field}": "no such file" for field in ("ca", "certificate", "key")}
    interrupt = signal.getsignal(signal.SIGINT)
    wrong = [({"network.listen": [endpoint]}, "Address already in use"), (lost, "No such file or directory")]
    try:
        for settings, why in wrong:
            run_file.write_text(toml_text(resolve("quick", settings)))
            with pytest.raises(Wrong, match=rf"network\.listen, ca, certificate or key: .*{why} \(os error \d+\); should be a free port"):
                run(BridgeOptions(run_file, "s3"))
    finally:
        signal.signal(signal.SIGINT, interrupt)
        taken.close()


def test_without_the_package_of_messages_the_command_says_what_to_install(run_file: Path) -> None:
    program = "import sys; sys.modules.update(rosbags=None); from deploy.__main__ import main; main()"
    words = [sys.executable, "-c", program, "bridge", "--agent", "s3", "--run", str(run_file)]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT}/deploy/interface", "COVEY_LAUNCHER": ""}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("covey: bridge: needs rosbags: in a checkout COVEY_EXTRAS=ros ./covey version; elsewhere python -m pip")


def test_an_origin_just_below_zero_is_three_numbers(run_file: Path) -> None:
    words = ["bridge", "--agent", "s3", "--run", str(run_file), "--origin", "0", "0", "-1e-05", "--router", "foo"]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT}/deploy/interface"}
    done = subprocess.run([sys.executable, "-m", "deploy", *words], env=environment, capture_output=True, text=True, timeout=60)
    assert done.stderr == "bridge: --router 'foo': should be an endpoint such as tcp/192.168.1.7:7447\n"
