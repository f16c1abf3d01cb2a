"""Particles beside a Gaussian mixture on the same runs: `python -m deploy.bench.trackers [--team T] [--seconds S] [--seeds 1,2]`.

Both trackers get the same worlds. A row is one tracker: steady OSPA of each seed in m, the mean of |expected - true number|, bytes of a
Gossip and of what it says of targets, and CPU time of the whole swarm in one process for a second of world time.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from deploy.cli.errors import guarded
from deploy.scenario import resolve
from deploy.simulation import Simulation, compiled
from protocol.codec import encode
from protocol.messages import Gossip
from protocol.node import Event, messages_of

KINDS = ("particles", "gaussian-mixture")


def measure(kind: str, team: str, targets: int, seconds: float, seeds: Sequence[int]) -> dict[str, Any]:
    """The figures of one tracker."""
    ospa, apart, sizes, said, spent = [], [], list[int](), list[int](), 0.0
    for seed in seeds:
        options = {"run.seed": seed, "run.dt": 0.5, "run.seconds": seconds, "team.composition": team, "targets.count": targets}
        simulation = Simulation(resolve("efficacy", {**options, "filter.kind": kind}), backend=compiled())

        def hear(event: Event, now: float) -> None:
            for message in messages_of(event):
                if isinstance(message, Gossip):
                    sizes.append(len(encode(message)))
                    said.append(len(message.states_bytes) + len(message.ids_bytes) + len(message.components_bytes))

        simulation.scorer.on_event = hear
        begin = time.process_time()
        result = simulation.run()
        spent += time.process_time() - begin
        ospa.append(round(result.steady_ospa, 4))
        apart.append(result.cardinality_error)
    figures = {"mean_ospa": round(float(np.mean(ospa)), 4), "cardinality_error": round(float(np.mean(apart)), 3), "steady_ospa": ospa}
    figures |= {"gossip_bytes": round(float(np.mean(sizes))), "target_bytes": round(float(np.mean(said)))}
    return {"kind": kind, "team": team, **figures, "cpu_per_second": round(spent / (seconds * len(seeds)), 3)}


def main() -> int:
    """Print one line of JSON for each tracker."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--team", default="2", help="a team of the paper, or such as A4,B12")
    parser.add_argument("--targets", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=200.0)
    parser.add_argument("--seeds", default="1,2,3,4")
    given = parser.parse_args()
    seeds = [int(seed) for seed in given.seeds.split(",")]
    for kind in KINDS:
        print(json.dumps(measure(kind, given.team, given.targets, given.seconds, seeds)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(guarded(main))
