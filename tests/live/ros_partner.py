"""A robot in ROS 2 of another make: zenoh-ros2-sdk moves it by cmd_vel, and says where it is and what its sensor sees.

    python -m tests.live.ros_partner run.toml s3 PORT FOLDER X Y HEADING

It writes what it hears of estimates and cells into FOLDER/heard.json. X, Y, HEADING: where its odometry begins in the arena. The message
definitions that the SDK would download are made from the fields that rosbags knows. The SDK computes hashes and encodes on its own.
"""

import json
import math
import sys
import threading
import time
from pathlib import Path
from typing import Any

import zenoh_ros2_sdk
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk.message_registry import get_registry

from protocol.settings import load, sensor_of
from world.config import WorldConfig
from world.scene import Scene

PERIOD = 0.05  # s between two steps
START = (3.0, 2.0, 0.5)  # of the robot in the frame of its odometry
STORE: Any = get_typestore(Stores.ROS2_JAZZY)


def define(folder: Path, *kinds: str) -> None:
    """Write the definitions of message types and of all that they contain, where the SDK looks first."""
    for kind in kinds:
        parts: dict[str, Any] = {}
        text, _ = STORE.gendefhash(kind, parts, 2)
        for name, definition in {kind: text, **{inner: both[0] for inner, both in parts.items()}}.items():
            package, _, short = name.rpartition("/")
            file = folder / package / f"{short}.msg"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(definition)
    get_registry().messages_dir = folder


class Robot:
    """A holonomic robot: odometry and scans out, cmd_vel in."""

    def __init__(self, config: WorldConfig, name: str, port: int, folder: Path, origin: list[float]) -> None:
        self.pose, self.velocity, self.heard_at = START, (0.0, 0.0, 0.0), 0.0
        self.heard: dict[str, Any] = {"commands": 0, "targets": 0, "cells": 0, "turned": 0.0}
        self._moves = threading.Lock()
        self._config, self._name, self._folder, self._origin = config, name, folder, origin
        self._scene = Scene(config)
        self._scene.sensors[name] = sensor_of(config, config.members[name])
        self._odometry = self._publisher("odom", "nav_msgs/msg/Odometry", port)
        self._detections = self._publisher("detections", "geometry_msgs/msg/PoseArray", port)
        for topic, kind, callback in (
            ("cmd_vel", "geometry_msgs/msg/Twist", self._on_command),
            ("targets", "geometry_msgs/msg/PoseArray", self._on_targets),
            ("cell", "geometry_msgs/msg/PolygonStamped", self._on_cell),
        ):
            zenoh_ros2_sdk.ROS2Subscriber(f"/{name}/{topic}", kind, callback, router_port=port)

    def _publisher(self, topic: str, kind: str, port: int) -> Any:
        return zenoh_ros2_sdk.ROS2Publisher(f"/{self._name}/{topic}", kind, router_port=port)

    def _on_command(self, said: Any) -> None:
        with self._moves:
            self.velocity, self.heard_at = (said.linear.x, said.linear.y, said.angular.z), time.monotonic()
            self.heard["commands"] += 1

    def _on_targets(self, said: Any) -> None:
        self.heard["targets"] += 1
        self.heard["places"] = [[pose.position.x, pose.position.y] for pose in said.poses]

    def _on_cell(self, said: Any) -> None:
        self.heard["cells"] += 1
        self.heard["corners"] = [[corner.x, corner.y] for corner in said.polygon.points]

    def run(self) -> None:
        """Move for ever; a robot that hears nothing for 0.3 s stands."""
        begun = self._config.bodies.epoch
        while True:
            time.sleep(PERIOD)
            with self._moves:
                fresh = time.monotonic() - self.heard_at < 0.3
                ahead, left, turn = self.velocity if fresh else (0.0, 0.0, 0.0)
                x, y, heading = self.pose
                cos, sin = math.cos(heading), math.sin(heading)
                self.pose = (x + PERIOD * (cos * ahead - sin * left), y + PERIOD * (sin * ahead + cos * left), heading + PERIOD * turn)
                self.heard["turned"] += abs(PERIOD * turn)
            self._scene.step_until(int((time.time() - begun) * self._config.run.rate / self._config.run.dt))
            self._say()

    def _say(self) -> None:
        kind = zenoh_ros2_sdk.get_message_class
        x, y, heading = self.pose
        place = kind("geometry_msgs/msg/Point")
        still = kind("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0)
        turned = kind("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=math.sin(heading / 2.0), w=math.cos(heading / 2.0))
        pose, covariance = kind("geometry_msgs/msg/Pose"), STORE_ZEROS
        head = self._header("odom")
        self._odometry.publish(
            header=head,
            child_frame_id="base_link",
            pose=kind("geometry_msgs/msg/PoseWithCovariance")(
                pose=pose(position=place(x=x, y=y, z=0.0), orientation=turned), covariance=covariance
            ),
            twist=kind("geometry_msgs/msg/TwistWithCovariance")(
                twist=kind("geometry_msgs/msg/Twist")(linear=still, angular=still), covariance=covariance
            ),
        )
        cos, sin = math.cos(self._origin[2]), math.sin(self._origin[2])
        at = self._origin[0] + cos * x - sin * y, self._origin[1] + sin * x + cos * y, self._origin[2] + heading
        [scan], _ = self._scene.scans({self._name: at})
        flat = kind("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)
        seen = [turned_back(at, float(east), float(north)) for east, north in scan]  # a camera's: in the robot's own frame
        poses = [pose(position=place(x=ahead, y=left, z=0.0), orientation=flat) for ahead, left in seen]
        self._detections.publish(header=self._header("base_link"), poses=poses)
        fresh = self._folder / "heard.new"
        fresh.write_text(json.dumps({**self.heard, "pose": self.pose, "at": at}))
        fresh.replace(self._folder / "heard.json")

    def _header(self, frame: str) -> Any:
        kind = zenoh_ros2_sdk.get_message_class
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        return kind("std_msgs/msg/Header")(stamp=kind("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds), frame_id=frame)


def turned_back(frame: tuple[float, float, float], x: float, y: float) -> tuple[float, float]:
    """A place in the frame that lies at a pose."""
    east, north, cos, sin = x - frame[0], y - frame[1], math.cos(frame[2]), math.sin(frame[2])
    return cos * east + sin * north, cos * north - sin * east


def main() -> None:
    """Be the robot."""
    file, name, port, folder, *origin = sys.argv[1:]
    define(Path(folder) / "messages", *KINDS)
    Robot(load(Path(file), WorldConfig), name, int(port), Path(folder), [*map(float, origin)]).run()


KINDS = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseArray", "geometry_msgs/msg/Twist", "geometry_msgs/msg/PolygonStamped")
if __name__ == "__main__":
    import numpy as np

    STORE_ZEROS = np.zeros(36)
    main()
