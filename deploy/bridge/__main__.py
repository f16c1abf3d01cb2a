"""`python -m deploy.bridge --config run.toml --agent s3`: the body of s3 is a robot that speaks ROS 2."""

import argparse
import os
import sys
import traceback
from pathlib import Path


def main() -> None:
    """Be the process of one bridge."""
    parser = argparse.ArgumentParser(prog="covey bridge", description="The body of an agent is a robot that speaks ROS 2 (rmw_zenoh).")
    parser.add_argument("--config", required=True, type=Path, metavar="FILE", help="run.toml, as `covey config` prints it")
    parser.add_argument("--agent", required=True)
    parser.add_argument("--router", default="tcp/127.0.0.1:7447", help="where rmw_zenohd listens")
    parser.add_argument("--domain", type=int, default=int(os.environ.get("ROS_DOMAIN_ID", "0") or 0))
    parser.add_argument(
        "--offset", type=float, default=0.0, help="m from the axle of a differential drive to its sensor; 0: moves in any direction"
    )
    parser.add_argument(
        "--origin", type=float, nargs=3, default=(0.0, 0.0, 0.0), help="of the odometry's frame in the arena: x m, y m, heading rad"
    )
    parser.add_argument("--keep", type=Path, help="file of the newest halt, which outlives the process")
    words = parser.parse_args()
    try:
        from deploy.bridge.bridge import run
        from deploy.bridge.settings import BridgeOptions, Wrong
    except ModuleNotFoundError as error:
        elsewhere = "elsewhere python -m pip install rosbags, or the wheel file with its extra [ros]"
        sys.exit(f"bridge: needs {error.name}: in a checkout COVEY_EXTRAS=ros ./covey version; {elsewhere}")
    try:
        code = run(BridgeOptions(words.config, words.agent, words.router, words.domain, words.offset, tuple(words.origin), words.keep))
    except Wrong as error:
        print(f"bridge: {error}", file=sys.stderr)
        code = 2
    except Exception:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    os._exit(code)  # a Zenoh session that failed to close could block the end of the interpreter


if __name__ == "__main__":
    main()
