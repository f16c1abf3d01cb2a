"""What an agent reads from a scenario: the common sections and those of its filter, births, capacity, partition and control.

Defaults are the readings of what the paper leaves open; docs/evidence/paper.md gives the reason for each.
"""

import math
from typing import Annotated, Literal

import msgspec

from protocol.message import SharedSettings
from protocol.sensing import SensorModel, measurement_of
from protocol.settings import CommonSettings, Fraction, NotNegative, Positive, Section, Seed
from protocol.settings_digest import common_sections, shared_settings

ParticleCount = Annotated[int, msgspec.Meta(ge=1, le=8000)]
BelowOne = Annotated[float, msgspec.Meta(ge=0.0, le=0.999999)]
Density = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]  # per m^2
Distance = Annotated[float, msgspec.Meta(ge=0.1, le=1000.0)]  # m


class FilterSettings(Section, frozen=True, kw_only=True):
    """[filter] the PHD filter of every agent."""

    kind: Literal["particles", "gaussian-mixture"] = "particles"  # what the PHD is made of
    seed: Seed = 0  # of all that the agents draw; 0 in a scenario: derived one-way from run.seed, which agents do not know
    speed: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 2.0  # of every particle, m/s
    heading_noise: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.3  # rad/sqrt(s)
    position_noise: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 0.1  # per axis and step, m
    lifetime: NotNegative = 1000.0  # mean survival time, s; 0 = for ever
    border: Literal["cross", "reflect"] = "cross"  # what a particle does at the border of the arena
    prior_density: Density = 0.001  # expected targets per m^2 at the start, and about so many in equilibrium
    prior_particles: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.3  # of the prior per m^2, at least
    particles_per_target: ParticleCount = 75
    least_particles: ParticleCount = 30  # per owner
    most_particles: ParticleCount = 2000  # per owner
    gate: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 6.0  # the likelihood is cut at this many standard deviations
    halo: Positive = 6.0  # what is updated around the own cell, m
    certainty: BelowOne = 0.999  # how sure the filter may be that a target is there: a miss is weighed against that
    vicinity: Distance = 3.0  # particles this close to each other may be one target, m
    compact: bool = False  # particles take 6 bytes on the wire instead of 24, for links of little bandwidth; needs timing.overlap = 0
    roughening: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.4  # width of a particle, in units of Silverman's rule


class MixtureSettings(Section, frozen=True, kw_only=True):
    """[mixture] what filter.kind = "gaussian-mixture" reads besides [filter]."""

    spread: Distance = 6.0  # largest standard deviation of a place, m; wider components are split
    merged: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 3.0  # components this close are merged, squared standard deviations
    pruned: Annotated[float, msgspec.Meta(gt=0.0, le=0.1)] = 1.0e-4  # components of less weight are dropped, expected targets
    most_components: Annotated[int, msgspec.Meta(ge=1, le=4096)] = 1000  # per owner; a limit against growth without bound


class PoseSettings(Section, frozen=True, kw_only=True):
    """[pose] how exactly the agents know their own poses: what they believe, not what is true."""

    position_noise: Annotated[float, msgspec.Meta(ge=0.0, le=1.0e5)] = 0.0  # standard deviation of a reported position on each axis, m
    heading_noise: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.0  # standard deviation of a reported heading, rad
    time_noise: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0  # standard deviation of the time at which a reported pose was true, s
    memory: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 0.0  # for how long an agent averages reports, moved on by its commands, s

    @property
    def is_exact(self) -> bool:
        """Whether the agents take reported poses for exact."""
        return self.position_noise == 0.0 and self.heading_noise == 0.0 and self.time_noise == 0.0


class BirthSettings(Section, frozen=True, kw_only=True):
    """[birth] where new targets may come from."""

    border_share: Fraction = 0.9  # of the background births lie on the border, the rest anywhere
    background_particles: ParticleCount = 12  # per tick over the whole arena
    background: bool = True
    measurement: bool = True
    measurement_particles: ParticleCount = 10  # per detection, if `measurement`
    radius: Distance = 4.0  # the local density is read within this distance, m
    least_density: Density = 1.0e-5  # the density is at least this, per m^2
    least_share: NotNegative = 0.25  # and at least this share of the clutter density, but not of more than twice `most_density`
    most_density: Density = 0.001  # the density is at most this, per m^2


class CapacitySettings(Section, frozen=True, kw_only=True):
    """[capacity] how the unused sensing capacity U is read (11)."""

    mode: Literal["literal", "expected", "static", "saturating"] = "literal"
    limit: Positive = 8.0  # saturating: the load at which nothing is left, expected targets


class PartitionSettings(Section, frozen=True, kw_only=True):
    """[partition] which diagram the cells come from."""

    kind: Literal["power", "voronoi", "voronoi-cod"] = "power"


class ControlSettings(Section, frozen=True, kw_only=True):
    """[control] how the body is driven (18)."""

    mode: str = "lloyd"  # lloyd, static, random, uniform-density, pursuit, search-and-track, or module:Class
    heading: Literal["centroid", "literal"] = "centroid"  # face the centroid from the sensor, or as printed from the COD


class SearchSettings(Section, frozen=True, kw_only=True):
    """[search] what control.mode = "search-and-track" weighs; values of 0 switch ingredients off."""

    bin: Annotated[float, msgspec.Meta(ge=0.01, le=10000.0)] = 2.0  # m, about a fifth of what sensors reach; lengths of the law follow it
    horizon: Annotated[float, msgspec.Meta(ge=0.1, le=10000.0)] = 2.0  # a goal is a place this far ahead, s; at least run.dt
    stale: Annotated[float, msgspec.Meta(ge=0.1, le=10000.0)] = 5.0  # mass out of view for longer is to be found, s
    weight: NotNegative = 20.0  # of mass that is to be found
    inflow: NotNegative = 0.06  # value of each bin at an open border
    confirmation: NotNegative = 4.0  # value of looking again at mass that may be no target
    sharing: Fraction = 1.0  # when goals are chosen: the share of a place's value that a farther sensor leaves to a nearer one
    falloff: Fraction = 0.4  # a track on top of the sensor or at the edge of its circle is worth this much less than one at the COD
    second_heading: NotNegative = 0.7  # weight of the heading after the next
    step_cost: NotNegative = 0.02  # of moving the goal by the way of a horizon
    capacity: NotNegative = 1.5  # targets that a sensor of 45 degrees can hold; 0: any number


class ExtractionSettings(Section, frozen=True, kw_only=True):
    """[extraction] how targets are read off the PHD."""

    bin: Annotated[float, msgspec.Meta(ge=0.01, le=1000.0)] = 1.0  # m. Under search-and-track 0.7
    threshold: Positive = 0.5  # mass of a 5 x 5 peak, expected targets. Under search-and-track 0.3
    beside: NotNegative = 0.0  # mass of what is left around an estimate to be another one. Under search-and-track 0.7


class TimingSettings(Section, frozen=True, kw_only=True):
    """[timing] of rounds and of membership."""

    deadline: Fraction = 0.5  # a round closes at this share of the period at the latest, in lockstep at this share of `run.patience`
    silent_rounds: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 4  # a silent peer stays a generator this long at least
    silence: NotNegative = 1.0  # and so long at least, s of the clock, realtime only
    listening_rounds: Annotated[int, msgspec.Meta(ge=0, le=100)] = 2  # incomplete rounds without a cell after a late start, at most
    look_ahead: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 0.0  # s after the own observation that a gossip may come, realtime only
    overlap: NotNegative = 0.0  # both claims count this close to a contested border, m (docs/explanation/decisions/0003)
    estimate_every: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 1  # ticks between two estimates
    interest: Literal["all", "neighbours"] = "all"  # whose gossip an agent hears; with neighbours beacons say who is one
    tile: Annotated[float, msgspec.Meta(ge=10.0, le=1.0e9)] = 35.0  # side of the squares in which beacons are said, m


class AgentConfig(CommonSettings, frozen=True, kw_only=True, eq=False):
    """The settings of an agent process. Only the same object is equal to it, so that pure memos find results by their configuration."""

    filter: FilterSettings = FilterSettings()
    mixture: MixtureSettings = MixtureSettings()
    birth: BirthSettings = BirthSettings()
    pose: PoseSettings = PoseSettings()
    capacity: CapacitySettings = CapacitySettings()
    partition: PartitionSettings = PartitionSettings()
    control: ControlSettings = ControlSettings()
    search: SearchSettings = SearchSettings()
    extraction: ExtractionSettings = ExtractionSettings()
    timing: TimingSettings = TimingSettings()

    @property
    def shared_seed(self) -> int:
        """The seed that all agents share."""
        return self.filter.seed

    def shared_settings(self) -> SharedSettings:
        """The settings that all agents must share to compute parts of one PHD and one diagram."""
        timing = {name: getattr(self.timing, name) for name in ("silent_rounds", "silence", "overlap", "interest", "tile")}
        own = {"filter": self.filter, "birth": self.birth, "pose": self.pose, "partition": self.partition, "timing": timing}
        own |= {"mixture": self.mixture} if self.filter.kind == "gaussian-mixture" else {}
        return shared_settings({**common_sections(self), **own})

    def others(self, name: str) -> list[str]:
        """The other agents of the roster, in its order.

        The roster is a hint: it names the agents expected at the start, may be empty, and other agents may join.
        """
        return [other for other in self.members if other != name]

    def why_not(self, sensor: SensorModel) -> str:
        """Why a swarm with these settings cannot use a sensor; empty: it can."""
        measures, far = measurement_of(sensor), math.hypot(self.arena.width, self.arena.height)
        if measures is None or measures.kind != "bearing":
            return ""
        if self.filter.kind == "gaussian-mixture":
            return 'measures = "bearing": a Gaussian mixture needs places or ranges; should be range-bearing, or filter.kind = "particles"'
        if sensor.reach > far:  # births lie along the whole beam, and the corrector's grid spans them
            return f'radius = {sensor.reach:g}: should be at most {far:.4g}, the diagonal of the arena in m, with measures = "bearing"'
        return ""

    @property
    def ticks_of_silence(self) -> int:
        """The ticks for which a silent peer stays a generator; in real time those of `timing.silence` s, if that is longer."""
        if self.run.clock == "lockstep":
            return self.timing.silent_rounds
        return max(self.timing.silent_rounds, math.ceil(self.timing.silence * self.run.rate / self.run.dt))

    def gossip_timeout(self, *, missed: bool) -> float:
        """How long an open round waits for missing gossips, s.

        `missed`: some peer was silent in the last round; in lockstep the round then waits a tenth as long. The timeout is a share of the
        time for which the world waits for a command: a round that waited all that time would always send its command too late.
        """
        if self.run.clock == "realtime":
            return self.timing.deadline * self.run.dt / self.run.rate
        return self.timing.deadline * self.run.patience * (0.1 if missed else 1.0)
