"""Every setting of an agent reaches the round: a small swarm goes another way when it changes, the same way with both arithmetics."""

from functools import cache
from typing import Any

import msgspec
import pytest

from agents.backend import PLAIN
from agents.config import (
    AgentConfig,
    BirthSettings,
    CapacitySettings,
    ControlSettings,
    ExtractionSettings,
    FilterSettings,
    MixtureSettings,
    PartitionSettings,
    PoseSettings,
    SearchSettings,
    TimingSettings,
)
from deploy.scenario import resolve
from deploy.simulation import Simulation, compiled
from protocol.node import Event, messages_of
from tests.golden.fields import digest, values_of
from tests.swarm.scene import fault

BASE: dict[str, Any] = {
    "team.composition": "A2,D2",
    "targets.count": 8,
    "arena.width": 36.0,
    "arena.height": 30.0,
    "run.dt": 0.25,
    "detection.clutter": 2.0,
    "filter.least_particles": 20,
    "birth.background_particles": 40,
    "capacity.mode": "saturating",
}
SECONDS = {"lloyd": 1.25, "search-and-track": 2.0}  # by control law: until every setting has mattered
CHANGES: dict[str, Any] = {  # another value of each; the base is BASE, and the defaults
    "filter.kind": "gaussian-mixture",
    "filter.seed": 5,
    "filter.speed": 1.5,
    "filter.heading_noise": 0.6,
    "filter.position_noise": 0.3,
    "filter.lifetime": 50.0,
    "filter.border": "reflect",
    "filter.prior_density": 0.002,
    "filter.prior_particles": 1.0,
    "filter.particles_per_target": 40,
    "filter.least_particles": 300,
    "filter.most_particles": 60,
    "filter.gate": 2.0,
    "filter.halo": 1.0,
    "filter.certainty": 0.5,
    "filter.vicinity": 1.0,
    "filter.roughening": 2.0,
    "birth.border_share": 0.2,
    "birth.background_particles": 25,
    "filter.compact": True,
    "birth.background": False,
    "birth.measurement": False,
    "birth.measurement_particles": 5,
    "birth.radius": 1.0,
    "birth.least_density": 0.0008,
    "birth.least_share": 0.001,
    "birth.most_density": 0.0001,
    "capacity.mode": "expected",
    "capacity.limit": 1.0,
    "partition.kind": "voronoi",
    "control.mode": "random",
    "control.heading": "literal",
    "extraction.bin": 0.7,
    "extraction.threshold": 0.2,
    "extraction.beside": 0.9,
    "detection.noise": 0.5,
    "limits.speed": 1.0,
    "limits.turn_rate": 0.3,
    "pose.position_noise": 0.2,
    "pose.heading_noise": 0.05,
    "pose.time_noise": 0.1,
    "timing.interest": "neighbours",
    "timing.estimate_every": 2,
}
IN_TROUBLE: dict[str, Any] = {  # settings that act only when words are late or missing
    "timing.deadline": 0.1,
    "timing.silent_rounds": 9,
    "timing.silence": 3.0,
    "timing.listening_rounds": 0,
    "timing.overlap": 3.0,
    "timing.look_ahead": 2.5,
}
TROUBLE = (fault(0.0, "delay", value=0.02, jitter=0.12), fault(0.5, "partition", "2", seconds=1.5), fault(1.0, "kill", "1", seconds=1.0))
IN_SEARCH: dict[str, Any] = {  # settings that act only under search-and-track
    "search.bin": 3.0,
    "search.horizon": 3.0,
    "search.stale": 0.1,
    "search.weight": 1000.0,
    "search.inflow": 0.5,
    "search.confirmation": 0.0,
    "search.sharing": 0.0,
    "search.falloff": 0.0,
    "search.second_heading": 0.0,
    "search.step_cost": 0.5,
    "search.capacity": 0.1,
}
IN_MIXTURES: dict[str, Any] = {  # settings that act only on a Gaussian mixture
    "mixture.spread": 3.0,
    "mixture.merged": 0.5,
    "mixture.pruned": 0.05,
    "mixture.most_components": 2,
}
OF_WRONG_POSES: dict[str, Any] = {"pose.memory": 1.0}  # settings that act only where poses are not exact
AMONG_NEIGHBOURS: dict[str, Any] = {"timing.tile": 12.0}  # settings that act only where agents hear their neighbours alone
SECTIONS = {
    "filter": FilterSettings,
    "mixture": MixtureSettings,
    "pose": PoseSettings,
    "birth": BirthSettings,
    "capacity": CapacitySettings,
    "partition": PartitionSettings,
    "control": ControlSettings,
    "search": SearchSettings,
    "extraction": ExtractionSettings,
    "timing": TimingSettings,
}


@cache
def said(
    setting: str = "", value: object = None, plain: bool = False, law: str = "lloyd", kind: str = "particles", noise: float = 0.0
) -> bytes:
    """The hash of all that the swarm says. `noise`: of the agents' poses, m."""
    base = BASE | {"run.seconds": SECONDS[law], "control.mode": law, "filter.kind": kind, "pose.position_noise": noise}
    options = base | ({setting: value} if setting else {})
    simulation, heard = Simulation(resolve("efficacy", options), backend=PLAIN if plain else compiled(), scores=False), []

    def hear(event: Event, now: float) -> None:
        for message in messages_of(event):
            if values := list(values_of(message).values()):
                heard.append(digest(values).hex())

    simulation.scorer.on_event = hear
    simulation.run()
    return digest(heard)


def test_every_setting_of_an_agent_is_changed_here() -> None:
    assert set(SECTIONS) <= set(AgentConfig.__struct_fields__)
    known = {f"{section}.{field}" for section, kind in SECTIONS.items() for field in kind.__struct_fields__}
    assert known <= {*CHANGES, *IN_SEARCH, *IN_MIXTURES, *IN_TROUBLE, *OF_WRONG_POSES, *AMONG_NEIGHBOURS}


@pytest.mark.parametrize("setting", CHANGES)
def test_a_setting_changes_what_the_swarm_does_alike_in_plain_and_compiled_arithmetic(setting: str) -> None:
    changed = said(setting, CHANGES[setting])
    assert changed != said()
    assert changed == said(setting, CHANGES[setting], plain=True)


def test_without_a_change_plain_and_compiled_arithmetic_agree_as_well() -> None:
    assert said() == said(plain=True)


@pytest.mark.slow
@pytest.mark.parametrize("setting", IN_SEARCH)
def test_a_setting_of_the_search_changes_what_the_swarm_does_alike_in_plain_and_compiled_arithmetic(setting: str) -> None:
    changed = said(setting, IN_SEARCH[setting], law="search-and-track")
    assert changed != said(law="search-and-track")
    assert changed == said(setting, IN_SEARCH[setting], plain=True, law="search-and-track")


@pytest.mark.parametrize("setting", IN_MIXTURES)
def test_a_setting_of_mixtures_changes_what_a_swarm_of_mixtures_does_and_nothing_else(setting: str) -> None:
    assert said(setting, IN_MIXTURES[setting], kind="gaussian-mixture") != said(kind="gaussian-mixture")
    assert said(setting, IN_MIXTURES[setting]) == said()


def test_a_setting_of_the_search_is_nothing_to_another_law() -> None:
    assert said("search.weight", 1.0) == said()


@pytest.mark.parametrize("setting", OF_WRONG_POSES)
def test_a_setting_of_wrong_poses_changes_what_the_swarm_does_alike_in_plain_and_compiled_arithmetic(setting: str) -> None:
    changed = said(setting, OF_WRONG_POSES[setting], noise=0.2)
    assert changed != said(noise=0.2)
    assert changed == said(setting, OF_WRONG_POSES[setting], plain=True, noise=0.2)
    assert said(setting, OF_WRONG_POSES[setting]) == said()


@pytest.mark.parametrize("setting", AMONG_NEIGHBOURS)
def test_a_setting_for_neighbours_changes_what_is_sent(setting: str) -> None:
    options = BASE | {"run.seconds": 2.0, "arena.width": 60.0, "timing.interest": "neighbours"}
    deliveries = []
    for change in ({}, {setting: AMONG_NEIGHBOURS[setting]}):
        simulation = Simulation(resolve("efficacy", options | change), scores=False)
        simulation.run()
        deliveries.append(simulation.bus.deliveries)
    assert deliveries[0] != deliveries[1]


@pytest.mark.parametrize("setting", IN_TROUBLE)
def test_a_setting_for_trouble_changes_what_the_swarm_does_in_trouble(setting: str) -> None:
    assert in_trouble(setting, IN_TROUBLE[setting]) != in_trouble()


@cache
def in_trouble(setting: str = "", value: object = None) -> str:
    """The transcript of the swarm in real time, with late words, a cut and a death."""
    options = BASE | {"run.seconds": 6.0} | ({setting: value} if setting else {})
    return Simulation(msgspec.structs.replace(resolve("efficacy", options), faults=TROUBLE), clock="realtime").run().transcript
