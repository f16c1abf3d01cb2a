"""The bridge of one agent: what its robot says in ROS 2 becomes its body in the swarm, and what the agent commands becomes cmd_vel.

/s3/odom        nav_msgs/Odometry            in   where the robot is
/s3/detections  geometry_msgs/PoseArray      in   what its sensor found and when, in the frame of the odometry or of the robot
/s3/cmd_vel     geometry_msgs/Twist          out  20 times a second, in the robot's own frame
/s3/targets     geometry_msgs/PoseArray      out  the targets that the agent believes in, in the arena's frame, `map`
/s3/cell        geometry_msgs/PolygonStamped out  its cell
"""

import contextlib
import math
import queue
import signal
import struct
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import zenoh

from deploy.bridge.body import RobotBody
from deploy.bridge.client import Heard, Participant
from deploy.bridge.frames import Placement, Planar, beyond_reach, heading_of, moved, placed, wheels
from deploy.bridge.odometry import Odometry
from deploy.bridge.ros import RosNode, message
from deploy.bridge.settings import BridgeOptions, Wrong, check, read_run
from deploy.bridge.watchdog import BridgeWatchdog

ARENA_FRAME = "map"
DRIVE_PERIOD = 0.05  # s between two cmd_vel: drivers stop after some tenths of a second without
WAKE = 0.02  # s at most between two looks at the clock
ASTRAY = 1.0  # m beyond the fence
EVERYWHERE = -math.inf, -math.inf, math.inf, math.inf  # where there is no fence
TELL_PERIOD = 3.0  # s between two lines about silent topics, at least
ODOMETRY, POSES, TWIST, POLYGON = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/PolygonStamped",
)


class Bridge:
    """A body and its robot."""

    def __init__(self, options: BridgeOptions) -> None:
        self._options = options
        run, network, rules = read_run(options)
        self._client = Participant(network, run, options.agent)
        self._limit, self._box = rules.turn_rate, rules.box
        self.body = RobotBody(rules, self._client.incarnation, self._client.say, self._client.appear)
        self._watchdog = BridgeWatchdog(rules.expected, network.lease)
        self._axle = Odometry()  # of the robot, in the arena's frame
        self._frames: tuple[str, str] | None = None  # names of the odometry's frame and of the robot's own, once it has said them
        self._foreign: set[str] = set()  # other frames that scans have named
        self._is_stamp_told = False  # that a scan was of another time than all odometry
        self._is_place_told = False  # that the robot was beyond its fence
        self._reach = rules.reach  # m of the sensor; infinite once detections beyond it were told
        self._silent, self._tell_at = tuple[str, ...](), 0.0  # the silent topics that were told, and when the next may be
        self._moves = threading.Lock()  # odometry comes in a thread of Zenoh
        for heard in kept(options.keep):
            self.body.hear(heard, 0.0)
        ros, name = RosNode("covey", f"/{options.agent}", router=options.router, domain=options.domain), options.agent
        self._ros = ros
        self._drive, self._targets, self._cell = (
            ros.publisher(f"/{name}/{topic}", kind) for topic, kind in (("cmd_vel", TWIST), ("targets", POSES), ("cell", POLYGON))
        )
        ros.subscribe(f"/{name}/odom", ODOMETRY, self._on_odometry)
        ros.subscribe(f"/{name}/detections", POSES, self._on_detections)
        self._client.listen("gossip/*", "hello/*", f"command/{name}", f"estimate/{name}", "pose/*", "halt")

    def serve(self, over: threading.Event) -> int:
        """Take part until `over` or the end of the run; the exit code.

        It is 3 when a younger body has taken the name, and 4 when the run is strict and not all have come.
        """
        drive_at = 0.0
        self._tell_at = time.monotonic() + TELL_PERIOD
        while not (over.is_set() or self.body.replaced or self.body.over or self.body.incomplete):
            with contextlib.suppress(queue.Empty):
                self._on_heard(self._client.events.get(timeout=WAKE))
                while True:
                    self._on_heard(self._client.events.get_nowait())
            with self._moves:
                self.body.step(time.monotonic())
            if time.monotonic() >= drive_at:
                drive_at = time.monotonic() + DRIVE_PERIOD
                self._command(*self.body.motion(time.monotonic()))
            self._tell_silence(time.monotonic())
        ends = (
            (self.body.replaced, 3, f"a younger body of {self._options.agent} is in the run, and this one ends"),
            (self.body.incomplete, 4, "not all agents have come, and the run is strict"),
            (self.body.over, 0, "the run is over"),
        )
        for is_so, code, why in ends:
            if is_so:
                print(f"bridge: {why}", file=sys.stderr)
                return code
        return 0

    def close(self) -> None:
        """Stop the robot and leave both networks."""
        for _ in range(3):
            self._command((0.0, 0.0), 0.0)
            time.sleep(WAKE)
        self._client.appear(False)
        self._client.close()
        self._ros.close()

    def _on_odometry(self, said: Any) -> None:
        """Note where the robot is; the sensor of a differential drive sits ahead of the axle."""
        pose, twist, offset = said.pose.pose, said.twist.twist, self._options.offset
        axle = placed(self._options.origin, (pose.position.x, pose.position.y, heading_of(pose.orientation)))
        if not all(map(math.isfinite, axle)):
            return  # the body soon stands for want of odometry
        with self._moves:
            self._frames = said.header.frame_id, said.child_frame_id
            self._axle.note(stamp_of(said.header), axle, (twist.linear.x, twist.linear.y, twist.angular.z))
            self.body.at(placed(axle, (offset, 0.0, 0.0)), time.monotonic())
            self._tell_place(axle)

    def _on_detections(self, said: Any) -> None:
        """Note a scan in the odometry's frame or the robot's own, as its header says. There is no other, for nobody says where it lies.

        The robot's own frame lies where the robot was at the stamp of the scan (`Odometry.at`).
        """
        named, stamp = said.header.frame_id, stamp_of(said.header)
        with self._moves:
            if self._frames is None:
                return  # the body is not there before its odometry
            if named not in self._frames:
                self._refuse(named, *self._frames)
                return
            if named == self._frames[0]:
                frame = self._options.origin
            else:
                frame = self._axle.at(stamp)
                self._tell_stamp(stamp)
            places = [moved(frame, (pose.position.x, pose.position.y)) for pose in said.poses]
            self._tell_range(places)
            self.body.sees(places, time.monotonic())

    def _refuse(self, named: str, odometry: str, own: str) -> None:
        """Say once that scans in a frame do not count."""
        if named not in self._foreign:
            self._foreign.add(named)
            right = f"should be {odometry!r}, the odometry's frame, or {own!r}, its child_frame_id"
            print(f"bridge: /{self._options.agent}/detections: header.frame_id = {named!r}: {right}; these do not count", file=sys.stderr)

    def _tell_place(self, axle: Placement) -> None:
        """Say once that the robot is well beyond the fence: most likely the frame of its odometry lies elsewhere."""
        (x, y, _), (west, south, east, north), agent = axle, self._box or EVERYWHERE, self._options.agent
        if not self._is_place_told and max(west - x, x - east, south - y, y - north) > ASTRAY:
            self._is_place_told = True
            print(f"bridge: /{agent}/odom: the robot is at {x:.1f}, {y:.1f} m, beyond bodies.fence: is --origin right?", file=sys.stderr)

    def _tell_range(self, places: list[Planar]) -> None:
        """Say once that most detections of a scan lie where the sensor does not see: agents take these for clutter."""
        assert self.body.pose is not None
        words, too_far = beyond_reach(self._reach, [math.dist(place, self.body.pose[:2]) for place in places])
        if too_far:
            self._reach = math.inf
            print(f"bridge: /{self._options.agent}/detections: {words}; agents take such detections for clutter", file=sys.stderr)

    def _tell_stamp(self, stamp: int) -> None:
        """Say once that a scan is of another time than the odometry that is kept."""
        if not self._is_stamp_told and not self._axle.spans(stamp):
            self._is_stamp_told, agent = True, self._options.agent
            newest = f"the newest of /{agent}/odom, {self._axle.stamp / 1e9:.3f} s"
            right = f"should lie from 1 s before to 0.2 s after {newest}; the nearest pose counts"
            print(f"bridge: /{agent}/detections: header.stamp = {stamp / 1e9:.3f} s: {right}", file=sys.stderr)

    def _tell_silence(self, now: float) -> None:
        """Say why the body is not in the run, and when it is again, at most once in a while."""
        silent = self.body.silent(now)
        if now >= self._tell_at and silent != self._silent:
            self._tell_at, self._silent = now + TELL_PERIOD, silent
            topics = " and ".join(f"/{self._options.agent}/{topic}" for topic in silent)
            said = f"nothing comes of {topics}: the body is not in the run" if silent else "odometry and scans come: the body is in the run"
            print(f"bridge: {said}", file=sys.stderr)

    def _on_heard(self, heard: Heard) -> None:
        """Take what the swarm says; the agent's estimate is for people who watch in ROS."""
        before = self.body.halt
        with contextlib.suppress(KeyError, TypeError, ValueError, OverflowError, struct.error):  # a message of another form is passed over
            if heard.kind == "estimate":
                self._show(heard.fields)
            else:
                with self._moves:
                    self.body.hear(heard, time.monotonic())
                if reason := self._watchdog.take(heard, time.monotonic()):
                    print(f"bridge: joining the run again: {reason}", file=sys.stderr)
                    self._client.rejoin()
        if self.body.halt != before and self._options.keep is not None:
            keep(self._options.keep, self.body.halt)

    def _command(self, velocity: Planar, turn_rate: float) -> None:
        """Say the motion in the robot's own frame."""
        ahead, left, turn = wheels(velocity, turn_rate, self._axle.newest[2], self._options.offset, self._limit)
        self._drive.publish(message(TWIST, vector(ahead, left, 0.0), vector(0.0, 0.0, turn)))

    def _show(self, fields: dict[str, Any]) -> None:
        """Say the targets and the cell of an estimate."""
        poses = [message("geometry_msgs/msg/Pose", point(x, y), upright()) for x, y in rows(fields.get("targets", b""))]
        self._targets.publish(message(POSES, header(), poses))
        corners = [message("geometry_msgs/msg/Point32", x, y, 0.0) for x, y in rows(fields.get("cell", b""))]
        self._cell.publish(message(POLYGON, header(), message("geometry_msgs/msg/Polygon", corners)))


def rows(array: bytes) -> Iterator[Planar]:
    """The rows of an array of 2 float64."""
    return struct.iter_unpack("<2d", array)  # type: ignore[return-value]


def stamp_of(header: Any) -> int:
    """The stamp of a header, ns; 0: not set."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def header() -> Any:
    """A header of now, in the arena's frame."""
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    stamp = message("builtin_interfaces/msg/Time", seconds, nanoseconds)
    return message("std_msgs/msg/Header", stamp, ARENA_FRAME)


def point(x: float, y: float) -> Any:
    """A place in the plane."""
    return message("geometry_msgs/msg/Point", x, y, 0.0)


def vector(x: float, y: float, z: float) -> Any:
    """Three numbers."""
    return message("geometry_msgs/msg/Vector3", x, y, z)


def upright() -> Any:
    """No turn."""
    return message("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)


def keep(file: Path, halt: tuple[int, bool]) -> None:
    """Write an order to a file, whole or not at all; a full disk is told and ends nothing."""
    fresh = file.with_name(file.name + ".new")
    try:
        fresh.write_bytes(msgpack.packb(halt))
        fresh.replace(file)
    except OSError as error:
        print(f"--keep {file}: {error.strerror}: the halt is not kept", file=sys.stderr)


def kept(file: Path | None) -> Iterator[Heard]:
    """The halt that was kept in a file; raises Wrong for a file of another kind."""
    if file is None or not file.exists():
        return
    try:
        incarnation, held = msgpack.unpackb(file.read_bytes())
        yield Heard("halt", "operator", {"held": bool(held)}, int(incarnation))
    except (OSError, ValueError, TypeError, msgpack.UnpackException):
        raise Wrong(f"--keep {file}: no kept halt; remove it only when the robot may move") from None


def run(options: BridgeOptions) -> int:
    """Be the bridge until a signal; the exit code."""
    check(options)
    over = threading.Event()
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a client waits in Zenoh for its router, where Python would not hear it
    try:
        bridge = Bridge(options)
    except zenoh.ZError as error:
        why = str(error).split(" at /")[0].replace("[", "")  # without the line of Zenoh's source
        raise Wrong(f"--config {options.config}: network.listen, ca, certificate or key: {why}; should be a free port, and files") from None
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:  # as under `nohup`
            signal.signal(number, lambda *_: over.set())
    print(f"bridge: /{options.agent}/odom and /{options.agent}/detections in, /{options.agent}/cmd_vel out; Ctrl-C stops it", flush=True)
    try:
        return bridge.serve(over)
    finally:
        bridge.close()
