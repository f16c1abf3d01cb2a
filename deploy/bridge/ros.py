"""A node of ROS 2 without ROS: topics as rmw_zenoh lays them out, and their messages in CDR.

A topic is the key `<domain>/<topic>/<type>/<hash>`. Every node, publisher and subscription has a liveliness token, from which ROS draws
its graph. A sample carries an attachment: number, time and origin. Types and hashes (RIHS01) are those of ROS 2 Jazzy, by rosbags.
"""

import json
import struct
import time
import uuid
from collections.abc import Callable
from typing import Any

import zenoh
from rosbags.typesys import Stores, get_typestore

ROUTER = "tcp/127.0.0.1:7447"  # where rmw_zenohd listens
QOS = "::,10:,:,:,,"  # reliable, volatile, the last ten, and no deadlines: an empty place stands for the default
STORE = get_typestore(Stores.ROS2_JAZZY)


def dds_name(kind: str) -> str:
    """The name of a message type on the wire: geometry_msgs/msg/Twist becomes geometry_msgs::msg::dds_::Twist_."""
    package, middle, name = kind.split("/")
    return f"{package}::{middle}::dds_::{name}_"


def topic_key(domain: int, topic: str, kind: str) -> str:
    """The key of a topic's samples."""
    return f"{domain}/{topic.strip('/')}/{dds_name(kind)}/{STORE.hash_rihs01(kind)}"


def attachment(number: int, nanoseconds: int, origin: bytes) -> bytes:
    """What rmw_zenoh sends with a sample: its number, the Unix time, and the publisher's 16 bytes after their length."""
    return struct.pack("<qqB", number, nanoseconds, len(origin)) + origin


def message(kind: str, *parts: Any) -> Any:
    """A message of this type, its fields in the order of its definition."""
    return STORE.types[kind](*parts)


class Topic:
    """A publisher."""

    def __init__(self, publisher: Any, kind: str) -> None:
        self._publisher, self._kind = publisher, kind
        self._number, self._origin = 0, uuid.uuid4().bytes

    def publish(self, said: Any) -> None:
        """Say a message."""
        self._number += 1
        payload = bytes(STORE.serialize_cdr(said, self._kind))
        extra = attachment(self._number, time.time_ns(), self._origin)
        self._publisher.put(payload, encoding=zenoh.Encoding("application/cdr"), attachment=extra)


class RosNode:
    """A node with its topics, in one session."""

    def __init__(self, name: str, namespace: str, *, router: str = ROUTER, domain: int = 0) -> None:
        config = zenoh.Config()
        for key, value in {
            "mode": "peer",
            "connect/endpoints": [router],
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "listen/endpoints": ["tcp/127.0.0.1:0"],
            "scouting/multicast/enabled": False,
            "transport/shared_memory/enabled": False,
        }.items():
            config.insert_json5(key, json.dumps(value))
        self._session = zenoh.open(config)
        self._domain, self._entities = domain, 0
        self._place = f"@ros2_lv/{domain}/{self._session.info.zid()}/0"
        self._who = f"%/{namespace.replace('/', '%') or '%'}/{name}"
        self._held: list[Any] = [self._session.liveliness().declare_token(f"{self._place}/0/NN/{self._who}")]

    def publisher(self, topic: str, kind: str) -> Topic:
        """A publisher of an absolute topic such as /s3/cmd_vel."""
        declared = self._session.declare_publisher(topic_key(self._domain, topic, kind), congestion_control=zenoh.CongestionControl.DROP)
        self._enter("MP", topic, kind)
        self._held.append(declared)
        return Topic(declared, kind)

    def subscribe(self, topic: str, kind: str, on_message: Callable[[Any], None]) -> None:
        """Call back with every message of a topic; what cannot be read is passed over."""

        def hear(sample: zenoh.Sample) -> None:
            try:
                heard = STORE.deserialize_cdr(sample.payload.to_bytes(), kind)
            except (ValueError, IndexError, struct.error, AssertionError):
                return
            on_message(heard)

        self._held.append(self._session.declare_subscriber(topic_key(self._domain, topic, kind), hear))
        self._enter("MS", topic, kind)

    def close(self) -> None:
        """Leave the graph."""
        self._session.close()

    def _enter(self, entity: str, topic: str, kind: str) -> None:
        """Declare the token of a publisher (MP) or a subscription (MS)."""
        self._entities += 1
        what = f"{topic.replace('/', '%')}/{dds_name(kind)}/{STORE.hash_rihs01(kind)}/{QOS}"
        self._held.append(self._session.liveliness().declare_token(f"{self._place}/{self._entities}/{entity}/{self._who}/{what}"))
