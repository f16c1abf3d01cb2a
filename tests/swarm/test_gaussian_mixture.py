"""Swarms whose PHD is a Gaussian mixture: one central run, deaths, loss, and gossips of a quarter of the particles' size."""

from functools import cache

import msgspec
import numpy as np
import pytest

from agents.tracking.gaussian_belief import owned_by_sender
from agents.tracking.particles import canonical, join
from deploy.cli.scenario_checks import check_scenario
from deploy.scenario import Scenario, resolve
from deploy.simulation import Simulation, compiled
from deploy.verify import fuzz
from deploy.verify.central_filter import CentralMixture, mixture_difference
from protocol.codec import encode
from protocol.messages import Gossip
from protocol.settings import BadSetting
from tests.swarm.oracle import Eavesdropper
from tests.swarm.scene import fault, ledger, tracking, watch

MIXTURE = {"filter__kind": "gaussian-mixture"}
Said = dict[int, dict[str, Gossip]]  # by tick and name


def overheard(scenario: Scenario) -> Said:
    """All gossips of a run."""
    simulation, ear = Simulation(scenario, backend=compiled(), scores=False), Eavesdropper(scenario.run.name)
    simulation.bus.add(ear)
    simulation.run()
    return ear.gossips


def differences(scenario: Scenario, said: Said) -> list[float]:
    """The difference of what the agents own from a central run that starts from their first claims, tick by tick."""
    found: list[float] = []
    central: CentralMixture | None = None
    for tick in sorted(said)[:-1]:
        stated = {name: owned_by_sender(gossip) for name, gossip in said[tick + 1].items() if gossip.claim_names}
        owned = canonical(join([each.targets for each in stated.values()]))
        if central is None:
            central = CentralMixture(scenario, owned, tick)
            continue
        central.play(said[tick], {name: each.claim for name, each in stated.items()})
        found.append(mixture_difference(owned, central.mixture))
    return found


def small_scenario(kind: str) -> Scenario:
    return tracking(team="A2,C3,D2", side=40.0, run__seconds=6.0, filter__kind=kind)


def large_scenario(kind: str) -> Scenario:
    return tracking(team="2", side=100.0, targets=30, run__seconds=10.0, run__dt=0.5, filter__kind=kind)


@cache
def small() -> Said:
    """All gossips of a small swarm of mixtures."""
    return overheard(small_scenario("gaussian-mixture"))


@cache
def large() -> Said:
    """All gossips of a swarm of mixtures in the arena of the paper."""
    return overheard(large_scenario("gaussian-mixture"))


def test_without_loss_the_swarm_is_its_central_run_to_the_last_bit() -> None:
    assert max(len(gossip.components) for gossips in small().values() for gossip in gossips.values()) > 3
    assert differences(small_scenario("gaussian-mixture"), small()) == [0.0] * 22


@pytest.mark.slow
def test_in_the_large_arena_of_the_paper_it_is_so_too() -> None:
    assert differences(large_scenario("gaussian-mixture"), large()) == [0.0] * 18


def test_with_wrong_poses_it_is_so_too() -> None:
    errors = {f"bodies__{name}_error": size for name, size in (("position", 0.2), ("heading", 0.03), ("time", 0.1))}
    noises = {f"pose__{name}_noise": size for name, size in (("position", 0.2), ("heading", 0.03), ("time", 0.1))}
    scenario = tracking(team="A2,C3,D2", side=40.0, run__seconds=6.0, pose__memory=1.0, **errors, **noises, **MIXTURE)
    assert differences(scenario, overheard(scenario)) == [0.0] * 22


def test_a_component_is_owned_by_one_agent_and_that_is_the_one_of_its_cell() -> None:
    checked = 0
    for gossips in small().values():
        owners = [gossip for gossip in gossips.values() if gossip.claim_names]
        ids = np.concatenate([np.empty(0, np.uint64), *(gossip.components["id"] for gossip in owners)])
        assert len(np.unique(ids)) == len(ids)
        rows = np.array([gossip.claim[0] for gossip in owners])
        for owner, gossip in enumerate(owners):
            places = gossip.components["place"].astype(float)
            power = ((places[:, None] - rows[None, :, :2]) ** 2).sum(axis=2) - rows[None, :, 2] ** 2
            assert np.all(power[:, owner] <= power.min(axis=1) + 1e-3)  # m^2: a mean is rounded after it was assigned
            checked += len(places)
    assert checked > 100


@pytest.mark.parametrize("who", ["50%", pytest.param("s2", marks=pytest.mark.slow)])
def test_after_deaths_the_rest_cover_the_arena_and_no_mass_is_lost(who: str) -> None:
    seen = watch(ledger(fault(1.5, "kill", who), agents=6, run__seconds=3.0, **MIXTURE))
    masses = np.array(seen.masses[seen.at(2.0) :]) / seen.masses[0]
    assert max(seen.holes[seen.at(2.0) :]) <= 0.02
    assert masses.min() >= 0.99 and masses.max() <= 1.01


@pytest.mark.slow
def test_loss_of_gossips_costs_little_mass_and_after_it_the_swarm_is_one_again() -> None:
    seen = watch(ledger(fault(3.0, "drop", "100%", value=0.3, seconds=4.0), run__seconds=12.0, **MIXTURE), clock="realtime")
    masses = np.array(seen.masses[seen.at(10.0) :]) / seen.masses[0]
    assert masses.min() >= 0.9 and masses.max() <= 1.1
    assert max(seen.holes[seen.at(10.0) :]) <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (3, 5, 14, 23, 31))])
def test_the_invariants_hold_under_the_faults_of_a_seed(seed: int) -> None:
    case = fuzz.draw(seed)
    filters = msgspec.structs.replace(case.scenario.filter, kind="gaussian-mixture")
    mixtures = case._replace(scenario=msgspec.structs.replace(case.scenario, filter=filters))
    assert fuzz.play(mixtures, backend=compiled()) is None


@pytest.mark.slow
def test_a_gossip_has_a_quarter_of_the_bytes_that_it_has_with_particles() -> None:
    particles = overheard(large_scenario("particles"))
    mixed, cloudy = ([gossip for gossips in said.values() for gossip in gossips.values()] for said in (large(), particles))
    assert 0.0 < np.mean([len(encode(gossip)) for gossip in mixed]) < 0.25 * np.mean([len(encode(gossip)) for gossip in cloudy])
    assert not any(gossip.states_bytes or gossip.weight for gossip in mixed)


@pytest.mark.parametrize(
    ("setting", "value", "says"),
    [
        ("filter.kind", "gaussian", "filter.kind"),
        ("mixture.spread", 0.0, "mixture.spread"),
        ("mixture.merged", -1.0, "mixture.merged"),
        ("mixture.halo", 5.0, "mixture.halo"),
        ("sensors.P", {"angle": 240.0, "radius": 9.0, "measures": "bearing", "bearing_noise": 2.0}, "should be range-bearing"),
    ],
)
def test_a_wrong_setting_of_a_mixture_is_named_in_one_line(setting: str, value: object, says: str) -> None:
    options = {"filter.kind": "gaussian-mixture", "team.composition": "P3" if setting == "sensors.P" else "A3", setting: value}
    with pytest.raises(BadSetting) as error:
        check_scenario(resolve("efficacy", options))
    assert says in str(error.value) and "\n" not in str(error.value)


@pytest.mark.slow
def test_ranges_and_bearings_track_as_positions_of_like_noise_do() -> None:
    wide = {"angle": 240.0, "radius": 14.0, "prob_detection": 0.9}
    polar = {**wide, "measures": "range-bearing", "range_noise": 0.25, "bearing_noise": 2.0}
    found = []
    for sensor in (wide, polar):
        settings = {"sensors__P": sensor, "run__seconds": 10.0, **MIXTURE}
        found.append(Simulation(tracking(team="P4", side=30.0, targets=5, **settings), backend=compiled()).run().steady_ospa)
    assert found[1] == pytest.approx(found[0], abs=1.0)
