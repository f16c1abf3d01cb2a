"""How well the noise of a scenario fits recorded measurements: `python -m deploy.bench.residuals FOLDER`.

FOLDER is a copy of the MRCLAM data set. Each range and bearing is compared with the nearest true target in view of that measurement. The
share inside the 95 % band of the scenario's noise is 0.95 where the noise is right and Gaussian. Barcodes are not used, so a
measurement of nothing counts with the target next to it, if that lies within `NEAREST` m.
"""

import argparse
import json
import math
import sys

import numpy as np

from deploy.cli.errors import guarded
from deploy.scenario import resolve, world_config
from protocol.measuring import to_measurements, to_places
from protocol.sensing import WedgeSensor
from protocol.settings import sensor_of
from world.sources import sources_of

BAND = 1.959964  # deviations that hold 95 % of a Gaussian
NEAREST = 1.0  # m


def residuals(folder: str) -> dict[str, float]:
    """Number of measurements, bias and deviation of ranges in m and bearings in degrees, and shares inside the 95 % band."""
    scenario = resolve("mrclam", {"recorded.data": folder})
    config, sensor = world_config(scenario), sensor_of(scenario, next(iter(scenario.members.values())))
    assert isinstance(sensor, WedgeSensor) and sensor.measures is not None
    scene, found, lost = sources_of(config), list[np.ndarray](), 0
    for name in config.members:
        scene.bodies.place(name, (0.0, 0.0, 0.0))
    for tick in range(config.run.ticks):
        names = list(config.members)
        poses = [scene.bodies.poses[name] for name in names]
        nothing = np.empty((0, 2))
        scans = scene.detector.scans([sensor] * len(names), poses, names, nothing, np.empty(0), tick, None)  # type: ignore[arg-type]
        for number, (pose, scan) in enumerate(zip(poses, scans), start=1):
            others = scene.targets.positions[scene.targets.ids != number]
            for row, place in zip(scan.astype(float), to_places(sensor.measures, sensor.radius, pose, scan)):
                apart = np.hypot(*(others - place).T)
                if apart.min() > NEAREST:
                    lost += 1
                    continue
                exact = to_measurements(sensor.measures, pose, others[apart.argmin()][None])[0]
                found.append(np.array([row[0] - exact[0], math.remainder(row[1] - exact[1], 2.0 * math.pi)]))
        scene.targets.step()
        scene.bodies.move({})
    all_found = np.array(found)
    noise = np.array([sensor.measures.range_noise, sensor.measures.bearing_noise])
    inside = (np.abs(all_found) <= BAND * noise).mean(axis=0)
    return {
        "measurements": len(all_found),
        "farther_than_1_m": lost,
        "range_bias_m": float(all_found[:, 0].mean()),
        "range_deviation_m": float(all_found[:, 0].std()),
        "bearing_bias_deg": float(np.degrees(all_found[:, 1].mean())),
        "bearing_deviation_deg": float(np.degrees(all_found[:, 1].std())),
        "range_inside_95": float(inside[0]),
        "bearing_inside_95": float(inside[1]),
    }


def main() -> int:
    """Print the figures as one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", help="a copy of the MRCLAM data set")
    print(json.dumps(residuals(parser.parse_args().folder)))
    return 0


if __name__ == "__main__":
    sys.exit(guarded(main))
