"""Says on /s3/echo what it hears on /s3/cmd_vel, with zenoh-ros2-sdk, and prints once which topics it sees.

python -m tests.deploy.ros_echo PORT FOLDER
"""

import sys
import time
from pathlib import Path
from typing import Any

import zenoh_ros2_sdk

from tests.live.ros_partner import KINDS, define

TWIST = "geometry_msgs/msg/Twist"


def main() -> None:
    """Echo for ever."""
    port = int(sys.argv[1])
    define(Path(sys.argv[2]), *KINDS)
    back = zenoh_ros2_sdk.ROS2Publisher("/s3/echo", TWIST, router_port=port)

    def echo(said: Any) -> None:
        back.publish(linear=said.linear, angular=said.angular)

    zenoh_ros2_sdk.ROS2Subscriber("/s3/cmd_vel", TWIST, echo, router_port=port)
    for _ in range(100):
        topics = sorted(zenoh_ros2_sdk.get_topic_names_and_types(router_port=port))
        of_both = [zenoh_ros2_sdk.get_topic_info(topic, router_port=port) for topic, _ in topics]
        if len(topics) == 2 and all(info and info.publisher_count == info.subscriber_count == 1 for info in of_both):
            print(*(word for topic, kinds in topics for word in (topic, *kinds)), flush=True)
            break
        time.sleep(0.1)
    time.sleep(1000.0)


if __name__ == "__main__":
    main()
