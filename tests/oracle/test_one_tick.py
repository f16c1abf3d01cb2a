"""Where nothing is left to dice the swarm must do what the paper says, to 1e-9: cells, mass, load, U, power radius, COD and commands.

Particles that keep their heading and are born nowhere make a tick a plain function of what the agents have said at its beginning. The
oracle reads that from a recording and says what must come of it. Positions on the wire are 32-bit floats, but no rounding comes
between: an owner goes on with the positions that it has said.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from shapely import MultiPoint, Polygon, box, voronoi_polygons

from tests.oracle import cells, wedges
from tests.oracle.one_tick import Verdict, verdicts
from tests.oracle.paper_filter import Scan, correct, predict
from tests.oracle.recorded import Recorded, recorded
from tests.oracle.said import Tick, wedges_of

EXACT = 1e-9
NO_DICE = {"filter.heading_noise": 0.0, "filter.position_noise": 0.0, "birth.background": False, "birth.measurement": False}
SMALL = {"arena.width": 24.0, "arena.height": 24.0, "targets.count": 12, "filter.prior_density": 0.03, "detection.clutter": 1.0}
DENSE = {"filter.particles_per_target": 150, "run.seed": 2}  # so that particles which cannot turn stay with some targets for a while
USUAL: dict[str, Any] = {"team.composition": "A2,C2,F1", "run.seconds": 5.0, "filter.halo": 50.0, **SMALL, **DENSE, **NO_DICE}
SCENES: dict[str, dict[str, Any]] = {
    "as printed": {},
    "the usual halo of 6 m": {"filter.halo": 6.0},
    "U less the expected detections": {"capacity.mode": "expected", "control.heading": "literal"},
    "U that saturates": {"capacity.mode": "saturating", "capacity.limit": 2.0, "limits.turn_rate": 0.5},
    "U that stays": {"capacity.mode": "static", "filter.border": "reflect", "targets.border": "reflect"},
    "Voronoi cells": {"partition.kind": "voronoi", "control.heading": "literal", "filter.lifetime": 5.0},
    "Voronoi cells of the CODs": {"partition.kind": "voronoi-cod", "run.dt": 0.5, "limits.speed": 1.0},
    "empty cells": {"team.composition": "D1,G1,B4,C3", "control.heading": "literal", "run.seed": 3},
    "nothing to be found": {"filter.prior_density": 0.0, "limits.speed": 20.0},
}


@lru_cache
def judged(scene: str) -> tuple[Recorded, list[tuple[Tick, dict[str, Verdict]]]]:
    """A run, and each of its ticks but the first and the last beside the oracle's verdicts."""
    run, dice = recorded(*(USUAL | SCENES[scene]).items()), np.random.default_rng(1)
    sensors = wedges_of(run.settings)
    return run, [(tick, verdicts(tick, run.settings, sensors, dice)) for tick in run.ticks[1:-1]]


every_scene = pytest.mark.parametrize("scene", SCENES)


@every_scene
def test_the_generators_that_are_said_are_the_centroid_of_detection_and_the_radius_of_the_unused_capacity(scene: str) -> None:
    for tick, oracle in judged(scene)[1]:
        for name, said in tick.gossips.items():
            assert np.abs(oracle[name].cod - said.cod).max() <= EXACT
            assert abs(wedges.power_radius(said.unused) - said.power_radius) <= EXACT
            assert tick.estimates[name].cod == said.cod and tick.estimates[name].power_radius == said.power_radius


@every_scene
def test_the_cells_that_are_said_are_the_intersections_of_half_planes(scene: str) -> None:
    for tick, oracle in judged(scene)[1]:
        for name, estimate in tick.estimates.items():
            said = Polygon(estimate.cell) if len(estimate.cell) else Polygon()
            assert oracle[name].cell.symmetric_difference(said).area <= EXACT
            assert oracle[name].cell.hausdorff_distance(said) <= EXACT or said.is_empty


@every_scene
def test_the_masses_and_loads_that_are_said_are_those_of_the_corrector(scene: str) -> None:
    """Beyond the halo of its cell an agent does not correct: what it sees there counts as predicted (docs/evidence/paper.md)."""
    for tick, oracle in judged(scene)[1]:
        for name, estimate in tick.estimates.items():
            assert abs(oracle[name].mass - estimate.mass) <= EXACT
            if scene != "the usual halo of 6 m":
                assert abs(oracle[name].load - estimate.load) <= EXACT


@every_scene
def test_the_unused_capacity_that_is_said_follows_from_the_load_in_the_reading_that_was_asked_for(scene: str) -> None:
    run, ticks = judged(scene)
    for (tick, oracle), later in zip(ticks, run.ticks[2:]):
        for name, estimate in tick.estimates.items():
            assert abs(oracle[name].unused - estimate.unused) <= EXACT
            assert later.gossips[name].unused == estimate.unused


@every_scene
def test_the_commands_that_are_said_drive_to_the_centroid_of_the_phd_in_the_cell(scene: str) -> None:
    for tick, oracle in judged(scene)[1]:
        for name, said in tick.commands.items():
            assert np.abs(np.array(oracle[name].command) - (*said.velocity, said.turn_rate)).max() <= EXACT


@every_scene
def test_an_owner_says_each_particle_as_often_as_its_weight_asks_for_give_or_take_one(scene: str) -> None:
    run, ticks = judged(scene)
    for (_, oracle), later in zip(ticks, run.ticks[2:]):
        for name, said in later.gossips.items():
            own = oracle[name].own
            assert abs(said.weight * len(said.states) - own.mass()) <= EXACT
            if not len(said.states):
                continue
            apart, parents = cKDTree(own.states).query(said.states.astype(float))
            assert apart.max() <= 1e-5  # rounded to 32 bits
            states, place = np.unique(own.states.astype(np.float32), axis=0, return_inverse=True)
            drawn = np.bincount(place.ravel()[parents], minlength=len(states))
            wanted = np.bincount(place.ravel(), own.weights) / said.weight
            assert (np.abs(drawn - wanted) <= np.bincount(place.ravel())).all()


def test_together_the_scenes_hold_what_they_are_there_for() -> None:
    found = {scene: judged(scene)[1] for scene in SCENES}
    everybody = [(tick, name, one) for ticks in found.values() for tick, oracle in ticks for name, one in oracle.items()]
    assert sum(len(seen.detections) for tick, _, _ in everybody for seen in tick.observations.values()) > 1000
    assert sum(one.cell.is_empty for _, _, one in everybody) > 20
    assert sum(one.load > 1.0 for _, _, one in everybody) > 30
    assert sum(one.mass == 0.0 and not one.cell.is_empty for _, _, one in everybody) > 50
    limits = sum(abs(one.command[2]) < 0.4 for _, _, one in everybody), sum(abs(one.command[2]) >= 0.5 for _, _, one in everybody)
    assert min(limits) > 50


@pytest.mark.parametrize("kind", ["voronoi", "voronoi-cod"])
def test_without_weights_the_half_planes_give_the_voronoi_diagram_of_shapely(kind: str) -> None:
    ticks = judged("Voronoi cells")[1]
    said = list(ticks[0][0].gossips.values())
    poses, cods = np.array([one.pose for one in said]), np.array([one.cod for one in said])
    diagram = cells.generators(poses, cods, np.array([one.power_radius for one in said]), kind)
    ours = cells.power_cells(diagram, 24.0, 24.0)
    arena = box(0.0, 0.0, 24.0, 24.0)
    theirs = voronoi_polygons(MultiPoint(diagram[:, :2]), extend_to=arena, ordered=True)
    for mine, one in zip(ours, theirs.geoms):
        assert mine.symmetric_difference(one.intersection(arena)).area <= EXACT
    assert (np.abs(diagram[:, :2] - (poses[:, :2] if kind == "voronoi" else cods)) == 0.0).all()


def test_with_births_from_its_detections_a_single_agent_has_the_mass_that_the_corrector_gives() -> None:
    """The places of births are dice, but their mass is not, as long as nobody else sees them and none falls out of the arena."""
    options = USUAL | {
        "team.composition": "A1",
        "birth.measurement": True,
        "targets.count": 8,
        "run.seconds": 30.0,
        "detection.clutter": 3.0,
    }
    run, dice = recorded(*options.items()), np.random.default_rng(1)
    sensors, born = wedges_of(run.settings), 0.0
    for tick in run.ticks[1:-1]:
        (scan,) = tick.scans(run.settings, sensors)
        if ((scan.detections < 1.0) | (scan.detections > 23.0)).any():
            continue
        before = predict(tick.particles(), run.settings, dice)
        after = correct(before, [scan], run.settings, dice)
        assert abs(after.mass() - tick.estimates["s1"].mass) <= EXACT
        born += after.mass() - correct(before, [_without_births(scan)], run.settings, dice).mass()
    assert born > 0.5


def _without_births(scan: Scan) -> Scan:
    return scan._replace(detections=scan.detections[:0])


@pytest.mark.parametrize(("section", "field"), [("detection", "clutter"), ("detection", "noise")])
def test_an_oracle_with_a_planted_error_disagrees_at_once(section: str, field: str) -> None:
    run = judged("as printed")[0]
    wrong = run.settings | {section: run.settings[section] | {field: 2.0 * run.settings[section][field]}}
    oracle = verdicts(run.ticks[5], wrong, wedges_of(wrong), np.random.default_rng(1))
    said = run.ticks[5].estimates
    assert max(abs(one.mass - said[name].mass) for name, one in oracle.items()) > 1e6 * EXACT


def test_of_places_where_two_cells_meet_the_first_generator_has_the_ground() -> None:
    twins = np.array([[5.0, 5.0, 1.0], [5.0, 5.0, 1.0], [15.0, 5.0, 2.0]])
    first, second, third = cells.power_cells(twins, 20.0, 10.0)
    assert second.is_empty and math.isclose(first.area + third.area, 200.0)
    assert cells.owners(np.array([[5.0, 5.0], [15.0, 5.0]]), twins).tolist() == [0, 2]
