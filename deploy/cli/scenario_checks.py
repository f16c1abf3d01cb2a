"""Checks of a scenario beyond its types: teams, classes of the user, faults, endpoints, memory."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import msgspec
import numpy as np

from agents.coverage.capacity import sensor_facts
from agents.coverage.control import ControlLaw, Situation
from agents.coverage.laws import CheckedLaw, control_law
from agents.interest.selection import GRID_SPACING, SELECTION_MARGIN
from agents.tracking.births import prior_size
from agents.tracking.gaussian_phd import PRIOR_DEVIATION
from agents.tracking.particles import unlabelled
from agents.tracking.phd import BINS_IN_VICINITY
from deploy.cli.sensor_checks import check_sensor
from deploy.faults.faults import LINK_VERBS, check_listed_fault, plain_verb
from deploy.faults.rehearsal import rehearse
from deploy.scenario import (
    ORACLE,
    FaultSettings,
    Scenario,
    TeamSettings,
    agent_config,
    check_names,
    check_oracle,
    check_triple,
    recording_remarks,
    spelled_out,
    unsimulated,
    world_config,
    world_names,
)
from protocol.endpoints import check_endpoints
from protocol.gaussian_components import MAX_COMPONENTS, MOST_MASS
from protocol.geometry import rectangle
from protocol.sensing import WedgeSensor, measurement_of
from protocol.setting_errors import mistakes
from protocol.settings import BadOption, BadSetting, sensor_of
from world.bodies import check_given, start_poses
from world.config import TargetSettings
from world.platform import SIMULATED, platform_class
from world.sources import READERS, body_source
from world.targets import Motion, build_motion

MOST_PRIOR = 1_000_000  # particles that an agent starts with
MOST_EXPECTED = 0.15 * MOST_MASS  # targets for each agent in the mean; of unequal cells the largest holds up to five times as many
MOST_BINS = 20_000_000  # of the grid on which an agent looks for targets, and of that on which it weighs a miss
T = TypeVar("T")
BLOCK = 5  # bins on a side of what an estimate is read off: agents/tracking/extraction.py
BINS_TO_NOISE = 2.0, 3.0  # `extraction.bin` in `detection.noise`: docs/how-to/fit.md#what-follows
LEAST_TICKS = 10.0  # in which a target crosses the reach of a sensor; shipped scenarios have 14 and more
MOST_SEARCHED = 1000.0  # m: with longer reaches agents that hear neighbours alone take several times as long as those that hear all
FITTING = "docs/how-to/fit.md"
TICKS_TRIED = 2  # of which a law and a motion of the user's own are asked, each by two objects
WAITED_FOR = {"delay", "slow", "starve", "freeze", "throttle"}  # faults whose effect is lateness
TEAM = {"team", "members", "sensors"}  # sections that are right or wrong together


def check_scenario(scenario: Scenario) -> None:
    """Raise BadSetting for the first thing that is wrong with a resolved scenario."""
    for _, line in complaints(scenario):
        raise BadSetting(line)


def all_mistakes(data: dict[str, Any], name: str, source: str, faults: Sequence[FaultSettings] = ()) -> list[str]:
    """All mistakes in the data of a scenario, a line each. A mistake that follows from another one is left out."""
    found, paths, rest = mistakes(data, Scenario)
    lines = [f"{source}: {line}" for line in found]
    wrong = {path[0] for path in paths}
    if not rest:
        return lines
    scenario = msgspec.convert(rest, Scenario)
    scenario = msgspec.structs.replace(scenario, faults=(*scenario.faults, *faults))
    try:
        scenario = scenario if wrong & TEAM else spelled_out(scenario, rest, name, source)
    except BadSetting as error:
        lines.append(str(error))
        wrong |= TEAM
    if wrong & TEAM:  # faults and control laws can be checked only with a valid team
        wrong |= TEAM | {"faults", "control"}
    later = [*complaints(scenario), *_network(scenario)]
    return lines + [f"{source}: {line}" for section, line in later if section not in wrong]


def complaints(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """The mistakes of a resolved scenario: the section, and a line that names a right value."""
    yield from _told("arena", lambda: check_costs(scenario))
    for sensor_class in dict.fromkeys([*scenario.members.values(), *scenario.sensors]):
        yield from _told("sensors", lambda name=sensor_class: _try_sensor(scenario, name))  # type: ignore[misc]
    yield from _told("mixture", lambda: _check_components(scenario))
    yield from _told("control", lambda: _try_law(scenario))
    yield from _told("targets", lambda: _try_motion(scenario))
    yield from _told("bodies", lambda: _try_bodies(scenario))
    yield from _told("recorded", lambda: _try_recording(scenario))
    yield from _told("pose", lambda: _check_memory(scenario))
    wrong = [told for number in range(len(scenario.faults)) for told in _told("faults", lambda number=number: _try_fault(scenario, number))]  # type: ignore[misc]
    yield from wrong or (("faults", finding.text) for finding in rehearse(scenario) if finding.is_refused)


def fault_remarks(scenario: Scenario) -> list[str]:
    """A line for each fault that changes nothing."""
    return [finding.text for finding in rehearse(scenario) if not finding.is_refused]


def team_remarks(scenario: Scenario) -> list[str]:
    """A line where [team] gives classes that its team does not read."""
    triple = scenario.team.triple
    try:
        check_triple(scenario.team.composition, triple if triple != TeamSettings().triple else None)
    except BadOption as error:
        return [f"team.triple = {triple!r}: {error.right}"]
    return []


def interest_remarks(scenario: Scenario) -> list[str]:
    """Lines where agents that hear neighbours alone may miss one, or take long to choose them: for sensors much larger than Table I's.

    A COD jumps by twice its offset when its sensor turns round. The choice looks at points all over what a sensor reaches.
    """
    if scenario.timing.interest == "all":
        return []
    sensors = [sensor_of(scenario, name) for name in dict.fromkeys(scenario.members.values())]
    jump, reach = max(2.0 * math.hypot(*sensor_facts(sensor).cod_offset) for sensor in sensors), max(sensor.reach for sensor in sensors)
    reasons = []
    if jump > SELECTION_MARGIN:
        reasons.append(f"agents choose with a margin of {SELECTION_MARGIN:g} m, and a COD may jump by {jump:.4g} m: some may be missed")
    if reach > MOST_SEARCHED:
        reasons.append(f"agents look at points {GRID_SPACING:g} m apart, and a sensor reaches {reach:.4g} m: the choice takes long")
    return [f"timing.interest = 'neighbours': {reason}; should be 'all'" for reason in reasons]


def scale_remarks(scenario: Scenario) -> list[str]:
    """A line for each of two settings that does not fit the class of sensors with the smallest reach, and would cost most of the targets.

    And a line for `mixture.spread` where components are born wider than that: in quick with a noise of 3 m a spread of 1 m takes 30 times
    as long as one of 3 m.

    Of particles an estimate is read off a block of 5 x 5 bins. Where such a block is wider than the reach, targets in view become one.
    A target of `filter.speed` that crosses the reach within a few ticks has left before scans could weigh it. In the lab of
    docs/how-to/fit.md the steady OSPA is 1.5 times as large with a block as wide as the reach, and 2.7 times with 10 ticks.
    """
    sensors = {name: sensor_of(scenario, name) for name in scenario.members.values()}
    name = min(sensors, key=lambda name: sensors[name].reach)
    side, noise, speed, (few, many) = scenario.extraction.bin, scenario.detection.noise, scenario.filter.speed, BINS_TO_NOISE
    reach, has_places = sensors[name].reach, measurement_of(sensors[name]) is None
    ticks, remarks = reach / (speed * scenario.run.dt), []
    if scenario.filter.kind == "particles" and has_places and BLOCK * side > reach and side > many * noise:
        wide = f"a target is read off {BLOCK} x {BLOCK} bins, and {name} reaches {reach:g} m"
        right = f"{few * noise:g} to {many * noise:g} m, {few:g} to {many:g} times detection.noise"
        remarks.append(f"extraction.bin = {side:g}: {wide}; should be {right} ({FITTING})")
    if ticks < LEAST_TICKS:
        fast = f"crosses the reach of {name}, {reach:g} m, in {ticks:.1f} ticks"
        remarks.append(f"filter.speed = {speed:g}: {fast}; should be the usual speed of your targets, or run.dt less ({FITTING})")
    if scenario.filter.kind == "gaussian-mixture" and has_places and noise > scenario.mixture.spread:
        slow = "what is born at a detection is split until it is narrower than its noise, and rounds take long"
        remarks.append(f"mixture.spread = {scenario.mixture.spread:g}: {slow}; should be at least detection.noise, {noise:g} m")
    return remarks


def faults_that_are_waited_for(scenario: Scenario) -> str:
    """A line about faults of which a simulation in lockstep may show nothing; empty if there are none."""
    found, longest = ", ".join(sorted(_verbs(scenario) & WAITED_FOR)), scenario.timing.deadline * scenario.run.patience
    line = f"without --rate 1 rounds of a simulation wait up to {longest:g} s for what is late, so these may change nothing: {found}"
    return line if found else ""


def simulation_remarks(scenario: Scenario, clock: str) -> list[str]:
    """A line for each fault that changes nothing, or may change nothing, in a simulation with this clock."""
    waited_for = faults_that_are_waited_for(scenario) if clock == "lockstep" else ""
    return [*fault_remarks(scenario), *([waited_for] if waited_for else [])]


def faults_on_links(scenario: Scenario) -> str:
    """A line about faults that real processes would refuse, because `network.link_faults` is missing; empty if there are none."""
    found = ", ".join(sorted(_verbs(scenario) & set(LINK_VERBS)))
    return f"real processes need network.link_faults = true for {found}" if found and not scenario.network.link_faults else ""


def faults_beyond_a_simulation(scenario: Scenario) -> str:
    """A line about faults of processes that a simulation does not have and refuses; empty if there are none."""
    struck = {name.strip() for fault in scenario.faults for name in fault.who.split(",")} & unsimulated(scenario)
    return f"a simulation has no such process to strike: {', '.join(sorted(struck))}" if struck else ""


def _verbs(scenario: Scenario) -> set[str]:
    return {plain_verb(fault.verb) for fault in scenario.faults}


def check_costs(scenario: Scenario) -> None:
    """Raise BadSetting, with a possible value, when an agent would need more memory or time than a machine has."""
    filters, arena = scenario.filter, scenario.arena
    area, particles = arena.width * arena.height, prior_size(filters, arena)
    if particles > MOST_PRIOR and area * filters.prior_particles > MOST_PRIOR:
        line = f"arena.width = {arena.width!r}, arena.height = {arena.height!r}: a prior of {particles} particles"
        raise BadSetting(f"{line}; should be at most {MOST_PRIOR / filters.prior_particles:.2g} m^2")
    if particles > MOST_PRIOR:
        most = MOST_PRIOR / (filters.particles_per_target * area)
        line = f"filter.prior_density = {filters.prior_density!r}: a prior of {particles} particles in {area:.3g} m^2"
        raise BadSetting(f"{line}; should be at most {most:.2g}")
    team = max(1, len(scenario.members))
    expected = filters.prior_density * area / team
    if expected > MOST_EXPECTED:
        line = f"filter.prior_density = {filters.prior_density!r}: a prior of {expected:.0f} expected targets for each of {team} agents"
        raise BadSetting(f"{line}; should be at most {MOST_EXPECTED * team / area:.2g}")
    if scenario.targets.count > MOST_EXPECTED * team:
        line = f"targets.count = {scenario.targets.count}: {scenario.targets.count / team:.0f} for each of {team} agents"
        raise BadSetting(f"{line}; should be at most {MOST_EXPECTED * team:.0f}")
    least = math.sqrt(area / (team * MOST_BINS))
    if scenario.extraction.bin < least:
        line = f"extraction.bin = {scenario.extraction.bin!r}: too fine for {area:.3g} m^2"
        raise BadSetting(f"{line}; should be at least {1.05 * least:.2g} m")
    if filters.kind == "particles" and filters.vicinity < BINS_IN_VICINITY * least:
        line = f"filter.vicinity = {filters.vicinity!r}: too fine for {area:.3g} m^2"
        raise BadSetting(f"{line}; should be at least {1.05 * BINS_IN_VICINITY * least:.2g} m")


def check_platform_class(scenario: Scenario) -> str:
    """A line about the platform of the user's own, where there is one; raises BadSetting where this machine cannot import it."""
    bodies = scenario.bodies
    if bodies.platform == SIMULATED:
        return ""
    if bodies.host == "world":
        return f"bodies.platform = {bodies.platform!r} is read with bodies.host = 'own' alone; one world simulates all bodies here"
    try:
        robot = platform_class(bodies)
    except BadSetting as error:
        raise BadSetting(f"{scenario.run.scenario}: {error}") from error.__cause__
    line = f"{bodies.platform} can be imported; `covey platform` tries it"
    if scenario.targets.count and getattr(robot, SIMULATED, False) is not True:
        line += f". Where it returns detections targets.count = {scenario.targets.count} should be 0: scores are those of simulated targets"
    return line


def _network(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """The mistakes that matter to a run with real processes only."""
    yield from _told("network", lambda: check_endpoints(scenario.network))
    yield from _told("members", lambda: check_names(scenario))


def _told(section: str, attempt: Callable[[], object]) -> Iterator[tuple[str, str]]:
    try:
        attempt()
    except BadSetting as error:
        yield section, str(error)


def _try_sensor(scenario: Scenario, sensor_class: str) -> None:
    sensor = sensor_of(scenario, sensor_class)
    if reason := agent_config(scenario).why_not(sensor):
        raise BadSetting(f"sensors.{sensor_class}.{reason}")
    if not isinstance(sensor, WedgeSensor):
        try:
            check_sensor(sensor, scenario.sensors[sensor_class].model)
        except BadSetting as error:
            raise BadSetting(f"sensors.{sensor_class}: {error}") from error.__cause__


def _try_law(scenario: Scenario) -> None:
    """Try a control law of the user for one agent in the middle of the arena."""
    if scenario.control.mode == ORACLE:
        check_oracle(scenario)
        return
    law = control_law(scenario)
    if not isinstance(law, CheckedLaw) or not scenario.members:  # a team with a mistake has none
        return
    name, sensor_class = next(iter(scenario.members.items()))
    middle, sensor = (scenario.arena.width / 2.0, scenario.arena.height / 2.0), sensor_of(scenario, sensor_class)

    def situation(tick: int) -> Situation:
        return Situation(
            name=name,
            seed=scenario.run.seed,
            tick=tick,
            dt=scenario.run.dt,
            pose=(*middle, 0.0),
            control_point=middle,
            cell=rectangle(scenario.arena.width, scenario.arena.height),
            centroid=middle,
            particles=unlabelled(np.array([[*middle, 1.0, 0.0]]), np.array([0.5]), np.array([1], dtype=np.uint64)),
            sensor=sensor,
            limits=scenario.limits,
            heading=scenario.control.heading,
            arena=(scenario.arena.width, scenario.arena.height),
            nearby_sensors=((sensor, (*middle, 0.0)),) if law.uses_nearby_sensors else (),
            generators=np.array([middle]),
            own_generator=0,
        )

    def ask(one: ControlLaw, tick: int) -> np.ndarray:
        velocity, turn_rate = one.command(situation(tick))
        return np.array([*velocity, turn_rate])

    _ask_two(f"{scenario.control.mode}.command", (law, control_law(scenario)), ask, "what `situation` has said to this object alone")


def _ask_two(what: str, two: tuple[T, T], ask: Callable[[T, int], np.ndarray], source: str) -> None:
    """Raise BadSetting where two objects of a class of the user's answer the same questions differently: no run could be repeated."""
    one, other = two
    for tick in range(TICKS_TRIED):
        if not np.array_equal(ask(one, tick), ask(other, tick)):
            wrong = f"{what} gives two answers to the same question, of tick {tick}: should follow from {source}"
            raise BadSetting(f"{wrong}; no clock, no global random numbers, nothing that objects share")


def _try_motion(scenario: Scenario) -> None:
    """Try a motion model of the user for two targets, and for none."""

    def build() -> Motion:
        return build_motion(scenario.targets, scenario.run.dt, scenario.run.seed)

    def ask(one: Motion, tick: int) -> np.ndarray:
        return np.column_stack(one.move(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.0, 1.0]), np.array([1, 2], dtype=np.uint64), tick))

    if scenario.targets.motion != "constant-speed":
        _ask_two(f"{scenario.targets.motion}.move", (build(), build()), ask, "the seed, the ids and the tick alone")
        build().move(np.empty((0, 2)), np.empty(0), np.empty(0, dtype=np.uint64), 0)


def _try_bodies(scenario: Scenario) -> None:
    """Make no bodies of the model, and find a place for bodies with a size."""
    config = world_config(scenario)
    body_source(config)
    check_given(config)
    if scenario.limits.radius:
        start_poses(config)


def _try_recording(scenario: Scenario) -> None:
    """Read the files of a recorded world."""
    if scenario.recorded.kind == "none" and scenario.recorded.data:
        kinds = ", ".join(READERS)
        raise BadSetting(
            f"recorded.data = {scenario.recorded.data!r}: is not read with recorded.kind = 'none'; that should be one of {kinds}"
        )
    if scenario.recorded.kind != "none" and scenario.targets != TargetSettings():
        kind = scenario.recorded.kind
        raise BadSetting(f"recorded.kind = {kind!r}: has targets of its own; should be none where targets are set")
    recording_remarks(scenario)


def _check_components(scenario: Scenario) -> None:
    """Raise BadSetting where a sensor sees more Gaussians of the prior at once than an agent may tell: it weighs each with all others."""
    classes = dict.fromkeys(scenario.members.values())
    if scenario.filter.kind != "gaussian-mixture" or not scenario.filter.prior_density or not classes:
        return
    spread, area = scenario.mixture.spread, scenario.arena.width * scenario.arena.height
    seen = min(area, max(sensor_of(scenario, name).area for name in classes)) / (2.0 * PRIOR_DEVIATION * spread) ** 2
    if seen > MAX_COMPONENTS:
        line = f"mixture.spread = {spread:g}: a sensor sees {seen:.0f} Gaussians of the prior at once"
        raise BadSetting(f"{line}; should be at least {1.05 * spread * math.sqrt(seen / MAX_COMPONENTS):.2g} m")


def _check_memory(scenario: Scenario) -> None:
    """Raise BadSetting where agents have nothing to average, or move by no command of theirs."""
    memory, kind = scenario.pose.memory, scenario.recorded.kind
    if memory and scenario.pose.is_exact:
        raise BadSetting(f"pose.memory = {memory:g}: has no errors to average; should be 0, or pose.position_noise and so on more than 0")
    if memory and kind == "mrclam":
        raise BadSetting(f"pose.memory = {memory:g}: should be 0 with recorded.kind = {kind!r}, whose bodies obey no command")


def _try_fault(scenario: Scenario, number: int) -> None:
    fault, where = scenario.faults[number], f"faults[{number}]."
    check_listed_fault(scenario.faults, number, list(scenario.members), world_names(scenario), live=False, link_faults=True)
    if fault.verb == "join":
        sensor_class = str(fault.options["class"])
        try:
            sensor_of(scenario, sensor_class)
        except BadSetting as error:
            raise BadSetting(f"{where}options.class = {sensor_class!r}: {error}") from None
    last = (scenario.run.ticks - 1) * scenario.run.dt
    if fault.at > last:
        raise BadSetting(f"{where}at = {fault.at:g}: the run ends before; its last tick is at {last:g} s")
