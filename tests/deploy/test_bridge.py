"""The bridge to ROS 2: published hashes, an independent partner in both directions, and its session."""

import math
import queue
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgpack
import pytest

from deploy.bridge.bridge import Bridge, keep, kept, point, upright, vector
from deploy.bridge.client import Heard, Network, Participant, access_control
from deploy.bridge.frames import Placement, fenced, moved, placed, wheels
from deploy.bridge.odometry import Odometry
from deploy.bridge.ros import QOS, STORE, RosNode, attachment, message, topic_key
from deploy.bridge.settings import BridgeOptions
from deploy.bridge.watchdog import BridgeWatchdog
from deploy.live.certificates import make_keys
from protocol import keys, live
from protocol.access import access_control as of_the_swarm
from protocol.endpoints import free_port
from protocol.settings import NetworkSettings
from tests.deploy.test_robot_body import Desk

ROOT = Path(__file__).resolve().parents[2]
# As ROS 2 Jazzy installs them (share/<package>/msg/<Type>.json, REP 2011). Twist, Odometry and their parts: extracted by the CARLA project
# from osrf/ros:jazzy-desktop for its own test of type hashes. PoseArray and PolygonStamped: the type table of picoros.
PUBLISHED = {
    "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "geometry_msgs/msg/Twist": "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "geometry_msgs/msg/PoseArray": "RIHS01_af0cc36d190e104d546d168d6b39df04fa4b4ccecf59cb4c9ed328d3d5004aa0",
    "geometry_msgs/msg/PolygonStamped": "RIHS01_b7cf07932f1523d4b4088075945c1a0141f7cd21da87cc940fc61652e9138b46",
    "geometry_msgs/msg/Pose": "RIHS01_d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa",
    "std_msgs/msg/Header": "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
}


@pytest.mark.parametrize("kind", PUBLISHED)
def test_the_key_of_a_topic_bears_the_published_hash_of_its_type(kind: str) -> None:
    package, _, name = kind.split("/")
    assert topic_key(7, "/s3/x", kind) == f"7/s3/x/{package}::msg::dds_::{name}_/{PUBLISHED[kind]}"


def test_an_attachment_is_number_time_and_origin_in_33_bytes() -> None:
    origin = bytes(range(16))
    assert attachment(258, 3, origin) == bytes([2, 1, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 16]) + origin


def until(condition: Callable[[], Any], seconds: float = 20.0) -> Any:
    """What the condition gives once that is true."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "not reached"
        time.sleep(0.02)
    return found


@pytest.mark.live
def test_the_partner_of_another_make_reads_what_is_written_writes_what_is_read_and_finds_both_in_its_graph() -> None:
    port = free_port()
    router = live.open_session(NetworkSettings(mode="router", listen=(f"tcp/127.0.0.1:{port}",)))
    program = [sys.executable, "-m", "tests.deploy.ros_echo", str(port), tempfile.mkdtemp()]
    partner = subprocess.Popen(program, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    node = RosNode("covey", "/s3", router=f"tcp/127.0.0.1:{port}")
    heard: list[Any] = []
    try:
        node.subscribe("/s3/echo", "geometry_msgs/msg/Twist", heard.append)
        drive = node.publisher("/s3/cmd_vel", "geometry_msgs/msg/Twist")
        three = [message("geometry_msgs/msg/Vector3", *numbers) for numbers in ((1.5, -0.25, 0.0), (0.0, 0.0, 0.125))]

        def answered() -> bool:
            assert partner.poll() is None, partner.communicate()
            drive.publish(message("geometry_msgs/msg/Twist", *three))
            return bool(heard)

        until(answered)
        assert (heard[0].linear.x, heard[0].linear.y, heard[0].angular.z) == (1.5, -0.25, 0.125)
        assert partner.stdout is not None
        assert partner.stdout.readline().split() == ["/s3/cmd_vel", "geometry_msgs/msg/Twist", "/s3/echo", "geometry_msgs/msg/Twist"]
    finally:
        partner.kill()
        partner.communicate()
        node.close()
        router.close()


def test_the_quality_of_service_is_what_the_partner_takes_for_the_default() -> None:
    qos = pytest.importorskip("zenoh_ros2_sdk.qos")
    assert qos.QosProfile().encode() == QOS


def test_the_file_of_the_halt_holds_the_order_that_counts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, bridge = tmp_path / "halt", Bridge.__new__(Bridge)
    bridge.body, bridge._moves, bridge._options = Desk().body, threading.Lock(), BridgeOptions(tmp_path, "s3", keep=file)
    bridge._watchdog = BridgeWatchdog((), 5.0)
    for held, incarnation in ((True, 9), (False, 8)):
        bridge._on_heard(Heard("halt", "operator-1", {"held": held}, incarnation))
    for fields in ({}, {"held": [True]}):  # of another form
        bridge._on_heard(Heard("halt", "operator-1", fields, 10))
    assert [(one.incarnation, one.fields) for one in kept(file)] == [(9, {"held": True})]
    keep(tmp_path / "nowhere" / "halt", (9, True))
    assert "No such file or directory: the halt is not kept" in capsys.readouterr().err


def test_a_bridge_names_the_topics_that_keep_its_body_out_of_the_run_and_says_when_it_is_in(capsys: pytest.CaptureFixture[str]) -> None:
    bridge, desk = Bridge.__new__(Bridge), Desk()
    bridge.body, bridge._options, bridge._silent, bridge._tell_at = desk.body, BridgeOptions(Path(), "s3"), (), 100.0
    for now in (99.0, 100.0, 101.0):
        bridge._tell_silence(now)
    desk.at(103.0)
    bridge._tell_silence(103.0)
    desk.body.at((1.0, 2.0, 0.5), 106.0)
    bridge._tell_silence(106.0)
    assert capsys.readouterr().err.splitlines() == [
        "bridge: nothing comes of /s3/odom and /s3/detections: the body is not in the run",
        "bridge: odometry and scans come: the body is in the run",
        "bridge: nothing comes of /s3/detections: the body is not in the run",
    ]


@pytest.mark.parametrize(
    ("end", "code", "why"),
    [("replaced", 3, "a younger body of s3 is in the run"), ("incomplete", 4, "not all agents have come"), ("over", 0, "the run is over")],
)
def test_a_bridge_that_ends_by_itself_says_why(end: str, code: int, why: str, capsys: pytest.CaptureFixture[str]) -> None:
    bridge = Bridge.__new__(Bridge)
    bridge.body, bridge._options = Desk().body, BridgeOptions(Path(), "s3")
    setattr(bridge.body, end, True)
    assert bridge.serve(threading.Event()) == code
    assert capsys.readouterr().err.startswith(f"bridge: {why}")


def test_a_message_of_numbers_that_no_robot_has_ends_no_bridge() -> None:
    """The cell goes to ROS in 32 bits, and an incarnation may be kept in a file."""
    bridge, shown = Bridge.__new__(Bridge), SimpleNamespace(publish=lambda said: STORE.serialize_cdr(said, said.__msgtype__))
    bridge.body, bridge._targets, bridge._cell = Desk().body, shown, shown
    bridge._on_heard(Heard("estimate", "s3", {"cell": struct.pack("<2d", 1e39, 0.0)}, 7))
    client = Participant.__new__(Participant)
    client.events = queue.SimpleQueue()
    for incarnation in (math.inf, True, "9", 9):
        packed = msgpack.packb({"wire": 2, "sender": "operator-1", "incarnation": incarnation, "held": True})
        client._on_sample(SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda packed=packed: packed), key_expr="covey/r/halt"))
    assert client.events.get_nowait().incarnation == 9 and client.events.empty()


@pytest.mark.parametrize(("fields", "is_heard"), [({}, True), ({"wire": 2}, True), ({"wire": 3}, False), (None, False)])
def test_a_halt_that_leaves_out_its_version_is_of_this_one(fields: dict[str, int] | None, is_heard: bool) -> None:
    """The version is a field with a default, and a robot must not go on because an operator has left it out."""
    client = Participant.__new__(Participant)
    client.events = queue.SimpleQueue()
    packed = msgpack.packb([] if fields is None else {"sender": "operator-1", "incarnation": 9, "held": True, **fields})
    client._on_sample(SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: packed), key_expr="covey/r/halt"))
    assert client.events.empty() != is_heard


def head(frame: str, stamp: float) -> Any:
    """A header of this stamp, s."""
    nanoseconds = round(stamp * 1e9)
    return message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", *divmod(nanoseconds, 1_000_000_000)), frame)


def odometry(x: float, y: float, heading: float, stamp: float, twist: Placement = (0.0, 0.0, 0.0)) -> Any:
    """An odometry of the robot `base`, whose twist is ahead and left, m/s, and rad/s."""
    turned = message("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(heading / 2.0), math.cos(heading / 2.0))
    pose = message("geometry_msgs/msg/Pose", point(x, y), turned)
    velocity = message("geometry_msgs/msg/Twist", vector(*twist[:2], 0.0), vector(0.0, 0.0, twist[2]))
    parts = {"pose": SimpleNamespace(pose=pose), "twist": SimpleNamespace(twist=velocity)}
    return SimpleNamespace(header=head("odom", stamp), child_frame_id="base", **parts)


def scan(frame: str, stamp: float, *places: tuple[float, float]) -> Any:
    """The detections of a scan."""
    poses = [message("geometry_msgs/msg/Pose", point(*place), upright()) for place in places]
    return message("geometry_msgs/msg/PoseArray", head(frame, stamp), poses)


def test_odometry_that_is_no_number_leaves_the_robots_heading_as_it_was() -> None:
    bridge = Bridge.__new__(Bridge)
    bridge.body, bridge._moves, bridge._options = Desk().body, threading.Lock(), BridgeOptions(Path(), "s3")
    bridge._axle, bridge._is_place_told, bridge._box = Odometry(), False, None
    for x in (1.0, math.nan):
        bridge._on_odometry(odometry(x, 2.0, 0.5, 0.0))
    assert bridge._axle.newest == pytest.approx((1.0, 2.0, 0.5))


def test_a_scan_counts_in_the_frames_of_the_odometry_and_of_the_robot_and_in_no_other(capsys: pytest.CaptureFixture[str]) -> None:
    bridge = Bridge.__new__(Bridge)
    bridge.body, bridge._moves, bridge._options = Desk().body, threading.Lock(), BridgeOptions(Path(), "s3", origin=(10.0, 0.0, 0.0))
    bridge._axle, bridge._frames, bridge._foreign, bridge._is_stamp_told = Odometry(), None, set(), False
    bridge._is_place_told, bridge._box, bridge._reach = False, None, math.inf

    def places(frame: str) -> list[tuple[float, float]] | None:
        bridge.body._scan = None
        bridge._on_detections(scan(frame, 0.0, (1.0, 0.0)))
        return bridge.body._scan and bridge.body._scan[0]

    assert places("odom") is None  # the frames are not known yet
    bridge._on_odometry(odometry(5.0, 2.0, 0.0, 0.0))
    assert (places("odom"), places("base")) == ([(11.0, 0.0)], [(16.0, 2.0)])
    assert places("camera_link") is places("camera_link") is None
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("bridge: /s3/detections: header.frame_id = 'camera_link': should be 'odom', the odometry's frame, or 'base',")


@pytest.mark.parametrize(
    ("stamped", "placed_by", "remarks"),
    [(-0.105, -0.105, 0), (0.0, 0.0, 0), (0.1, 0.0, 0), (None, 0.0, 0), (-9.0, -1.0, 1), (1e6, 0.0, 1)],
    ids=["late", "at once", "ahead", "without a stamp", "older than what is kept", "of another clock"],
)
def test_a_detection_of_a_turning_robot_is_placed_by_the_pose_at_the_stamp_of_its_scan(
    stamped: float | None, placed_by: float, remarks: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Times in s after the newest odometry. The robot drives, and turns left at 1 rad/s, through west at -0.105 s."""
    bridge = Bridge.__new__(Bridge)
    bridge.body, bridge._moves, bridge._options = Desk().body, threading.Lock(), BridgeOptions(Path(), "s3", origin=(10.0, 0.0, 0.3))
    bridge._axle, bridge._is_stamp_told, newest = Odometry(), False, 1.7e9
    bridge._is_place_told, bridge._box, bridge._reach = False, None, math.inf

    def where(time: float) -> tuple[float, float, float]:
        return 0.2 * time, 1.0, math.pi - 0.3 + 0.105 + time

    for number in range(150, -1, -1):
        bridge._on_odometry(odometry(*where(-0.01 * number), newest - 0.01 * number))
    for _ in range(2):
        bridge._on_detections(scan("base", 0.0 if stamped is None else newest + stamped, (2.0, 0.0)))
    assert bridge.body._scan is not None
    assert bridge.body._scan[0] == [pytest.approx(moved(placed((10.0, 0.0, 0.3), where(placed_by)), (2.0, 0.0)), abs=1e-5)]
    assert len(capsys.readouterr().err.splitlines()) == remarks


@pytest.mark.parametrize(("ahead", "moves"), [(0.1, True), (0.3, False)])
@pytest.mark.parametrize("turn", [1.0, math.nan])
def test_a_scan_that_is_a_moment_ahead_of_all_odometry_is_placed_where_the_robot_will_be_by_its_twist(
    ahead: float, moves: bool, turn: float
) -> None:
    """At 1 m/s and 1 rad/s. A scan farther ahead is of another clock; a twist that is no number is none."""
    bridge = Bridge.__new__(Bridge)
    bridge.body, bridge._moves, bridge._options = Desk().body, threading.Lock(), BridgeOptions(Path(), "s3")
    bridge._axle, bridge._is_stamp_told, bridge._is_place_told, bridge._box = Odometry(), False, False, None
    bridge._reach = math.inf
    bridge._on_odometry(odometry(3.0, 1.0, 0.5, 1.7e9, (1.0, 0.0, turn)))
    bridge._on_detections(scan("base", 1.7e9 + ahead, (2.0, 0.0)))
    there = placed((3.0, 1.0, 0.5), (math.sin(ahead), 1.0 - math.cos(ahead), ahead)) if moves and turn == 1.0 else (3.0, 1.0, 0.5)
    assert bridge.body._scan is not None
    assert bridge.body._scan[0] == [pytest.approx(moved(there, (2.0, 0.0)), abs=0.006)]


def test_a_scan_of_which_most_lies_beyond_the_reach_of_the_sensor_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    bridge = Bridge.__new__(Bridge)
    bridge.body, bridge._moves, bridge._options = Desk().body, threading.Lock(), BridgeOptions(Path(), "s3")
    bridge._axle, bridge._foreign, bridge._is_place_told, bridge._box, bridge._reach = Odometry(), set(), False, None, 5.0
    bridge._on_odometry(odometry(3.0, 1.0, 0.0, 0.0))
    bridge._on_detections(scan("odom", 0.0, (4.0, 1.0), (9.0, 1.0)))
    assert capsys.readouterr().err == ""
    for _ in range(2):
        bridge._on_detections(scan("odom", 0.0, (4.0, 1.0), (9.0, 1.0), (3.0, 8.0)))
    words = "2 of 3 lie beyond the reach of the sensor, 5 m, the farthest 7.0 m away; agents take such detections for clutter"
    assert capsys.readouterr().err == f"bridge: /s3/detections: {words}\n"


def test_odometry_whose_clock_is_set_back_or_that_has_no_stamps_counts_from_then_on() -> None:
    track, first, second = Odometry(), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)
    for stamp in (0, 5_000_000_000, 3_000_000_000):
        track.note(stamp, first)
        track.note(stamp, second)
        assert track.newest == track.at(0) == track.at(2_500_000_000) == track.at(9_000_000_000) == second


@pytest.mark.parametrize("fence", [True, False])
def test_a_robot_well_beyond_its_fence_is_told_of_once(fence: bool, capsys: pytest.CaptureFixture[str]) -> None:
    bridge = Bridge.__new__(Bridge)
    bridge.body, bridge._moves, bridge._options = Desk().body, threading.Lock(), BridgeOptions(Path(), "s3", origin=(0.0, 50.0, 0.0))
    bridge._axle, bridge._is_place_told, bridge._box = Odometry(), False, (-0.3, -0.3, 5.3, 5.3) if fence else None
    for y in (-44.0, -43.0, -42.0):
        bridge._on_odometry(odometry(1.0, y, 0.0, 0.0))
    said = "bridge: /s3/odom: the robot is at 1.0, 7.0 m, beyond bodies.fence: is --origin right?\n"
    assert capsys.readouterr().err == (said if fence else "")


def test_wheels_move_the_sensor_at_the_velocity_that_was_asked_for() -> None:
    heading, velocity, offset = 0.7, (0.4, -0.3), 0.2
    ahead, left, turn = wheels(velocity, 9.9, heading, 0.0, 5.0)
    assert moved((0.0, 0.0, heading), (ahead, left)) == pytest.approx(velocity) and turn == 5.0
    ahead, left, turn = wheels(velocity, 9.9, heading, offset, 50.0)
    step = 1e-6
    there = placed(placed((0.0, 0.0, heading), (step * ahead, 0.0, step * turn)), (offset, 0.0, 0.0))
    here = placed((0.0, 0.0, heading), (offset, 0.0, 0.0))
    assert [(b - a) / step for a, b in zip(here[:2], there[:2])] == pytest.approx(velocity, abs=1e-5) and left == 0.0
    slow = wheels(velocity, 0.0, heading, offset, 1.0)
    assert slow[2] == pytest.approx(math.copysign(1.0, turn)) and slow[0] / slow[2] == pytest.approx(ahead / turn)


def test_a_fence_shortens_what_leads_out_and_leaves_what_leads_back() -> None:
    box = (0.0, 0.0, 10.0, 10.0)
    assert fenced((2.0, 1.0), (9.5, 5.0, 0.0), box, 0.5) == (1.0, 1.0)
    assert fenced((2.0, -1.0), (11.0, 5.0, 0.0), box, 0.5) == (0.0, -1.0)
    assert fenced((-2.0, -1.0), (11.0, 5.0, 0.0), box, 0.5) == (-2.0, -1.0)


def test_the_access_control_of_a_bridge_lets_in_and_out_what_that_of_a_body_of_ours_does() -> None:
    agents = ("s1", "s2", "s3")
    theirs, ours = access_control("r", "s3", agents), of_the_swarm("r", agents)

    def allowed(rules: dict[str, Any], name: str, message: str, flow: str, key: str) -> bool:
        mine = [number for policy in rules["policies"] if name in policy["subjects"] for number in policy["rules"]]
        found = [rule for rule in rules["rules"] if rule["id"] in mine and message in rule["messages"] and flow in rule["flows"]]
        return any(keys.matches(expression, key) for rule in found for expression in rule["key_exprs"])

    says = [f"covey/r/{kind}/{name}" for kind in ("gossip", "hello", "pose", "command", "estimate") for name in agents] + ["covey/r/halt"]
    for name in (*agents, "monitor", "operator", "world", "x9"):
        for key in says:
            mine = key.endswith(("/s3", "halt")) or any(f"/{kind}/" in key for kind in ("gossip", "hello", "pose"))
            wanted = mine and allowed(ours, name, "put", "ingress", key)
            assert allowed(theirs, name, "put", "ingress", key) == wanted, (name, key)
        assert allowed(theirs, name, "put", "egress", "covey/r/observation/s3") == (name in ("s3", "monitor", "operator"))
        assert allowed(theirs, name, "put", "egress", "covey/r/pose/s3") == allowed(ours, name, "put", "egress", "covey/r/pose/s3")
        assert not allowed(theirs, name, "put", "egress", "covey/r/gossip/s3")
        for role in ("agent", "body"):
            key = f"covey/r/alive/{role}/s2/5"
            assert allowed(theirs, name, "liveliness_token", "ingress", key) == (name == "s2")


@pytest.mark.live
def test_with_certificates_a_bridge_is_heard_by_its_agent_alone_and_hears_no_command_of_another(tmp_path: Path) -> None:
    make_keys(["s1", "s3"], tmp_path)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    files = {"ca": f"{tmp_path}/ca.pem", "certificate": f"{tmp_path}/{{name}}.pem", "key": f"{tmp_path}/{{name}}.key"}

    def agent(name: str, **places: Any) -> Any:
        return live.open_session(NetworkSettings(admit=("s1", "s3"), **files, **places), keys.Token("r", "agent", name, 1))

    own = agent("s3", listen=(endpoint,))
    mine = {field: file.replace("{name}", "s3") for field, file in files.items()}
    participant = Participant(Network((endpoint,), ("tls/127.0.0.1:0",), **mine, admitted=("s1", "s3")), "r", "s3")
    participant.listen("gossip/*", "command/s3", "halt")
    other = agent("s1", seeds=(endpoint,), listen=(f"tls/127.0.0.1:{free_port()}",))
    seen: dict[str, list[str]] = {"s1": [], "s3": []}
    ears = [
        session.declare_subscriber("covey/r/observation/s3", lambda sample, name=name: seen[name].append(name))
        for name, session in (("s1", other), ("s3", own))
    ]
    said, heard = msgpack.packb({"wire": 2, "sender": "s3", "incarnation": 1}), list[tuple[str, str]]()
    of_s1 = msgpack.packb({"wire": 2, "sender": "s1", "incarnation": 1})

    def exchanged() -> bool:
        participant.say("observation", {})
        own.put("covey/r/command/s3", said)
        other.put("covey/r/command/s3", msgpack.packb({"wire": 2, "sender": "s3", "incarnation": 999}))
        other.put("covey/r/gossip/s1", of_s1)
        other.put("covey/r/halt", of_s1)
        while not participant.events.empty():
            event = participant.events.get()
            heard.append((event.kind, event.name))
            assert event.incarnation != 999 and event.kind != "halt", "forged by s1"
        return bool(seen["s3"]) and {("command", "s3"), ("gossip", "s1")} <= set(heard)

    until(exchanged)
    for _ in range(20):
        exchanged()
        time.sleep(0.02)
    assert seen["s1"] == []
    del ears
    for session in (own, other, participant):
        session.close()


def test_rows_of_an_array_are_pairs_of_numbers() -> None:
    from deploy.bridge.bridge import rows

    assert [*rows(struct.pack("<4d", 1.0, 2.0, 3.0, 4.0))] == [(1.0, 2.0), (3.0, 4.0)]
