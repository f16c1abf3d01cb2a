"""What an agent reads from a scenario: the common sections and those of its filter, births, capacity, partition and control.

Defaults are the readings of what the paper leaves open; docs/paper.md gives the reason for each.
"""

from typing import Annotated, Literal

import msgspec

from protocol.agreement import agreed, common_sections
from protocol.messages import Agreed
from protocol.settings import Common, Fraction, NotNegative, Positive, Section, Seed

ParticleCount = Annotated[int, msgspec.Meta(ge=1, le=8000)]
Certainty = Annotated[float, msgspec.Meta(ge=0.0, le=0.999999)]
Density = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]  # per m^2
Distance = Annotated[float, msgspec.Meta(ge=0.1, le=1000.0)]  # m


class FilterSettings(Section, frozen=True, kw_only=True):
    """[filter] the particle PHD filter of every agent."""

    seed: Seed = 0  # of all that the agents draw; 0 in a scenario: derived one-way from run.seed, which agents do not know
    speed: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 2.0  # of every particle, m/s
    heading_noise: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.3  # rad/sqrt(s)
    position_noise: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 0.1  # per axis and step, m
    lifetime: NotNegative = 1000.0  # mean survival time, s; 0 = for ever
    border: Literal["cross", "reflect"] = "cross"  # what a particle does at the border of the arena
    prior_density: Density = 0.001  # expected targets per m^2 at the start and in equilibrium
    particles_per_target: ParticleCount = 75
    least_particles: ParticleCount = 30  # per owner
    most_particles: ParticleCount = 2000  # per owner
    gate: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 6.0  # the likelihood is cut at this many standard deviations
    halo: Positive = 6.0  # what is updated around the own cell, m
    certainty: Certainty = 0.999  # how sure the filter may be that a target is there: a miss is weighed against that
    vicinity: Distance = 3.0  # particles this close to each other may be one target, m
    roughening: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.4  # width of a particle, in units of Silverman's rule


class BirthSettings(Section, frozen=True, kw_only=True):
    """[birth] where new targets may come from."""

    border_share: Fraction = 0.9  # of the background births lie on the border, the rest anywhere
    background_particles: ParticleCount = 12  # per tick over the whole arena
    background: bool = True
    measurement: bool = True
    copies: ParticleCount = 10  # particles per measurement birth
    radius: Distance = 4.0  # the local density is read within this distance, m
    least_density: Density = 1.0e-5  # the density is at least this, per m^2,
    least_share: NotNegative = 0.25  # and at least this share of the clutter density, but not of more than twice the most
    most_density: Density = 0.001  # and at most this, per m^2

    @property
    def on_border(self) -> int:
        """How many of the background births lie on the border."""
        return round(self.border_share * self.background_particles)


class CapacitySettings(Section, frozen=True, kw_only=True):
    """[capacity] how the unused sensing capacity U is read (11)."""

    mode: Literal["literal", "expected", "static", "saturating"] = "literal"
    limit: Positive = 8.0  # saturating: the load at which nothing is left, expected targets


class PartitionSettings(Section, frozen=True, kw_only=True):
    """[partition] which diagram the cells come from."""

    kind: Literal["power", "voronoi", "voronoi-cod"] = "power"


class ControlSettings(Section, frozen=True, kw_only=True):
    """[control] how the body is driven (18)."""

    mode: str = "lloyd"  # lloyd, static, random, uniform-density, pursuit, or module:Class
    heading: Literal["centroid", "literal"] = "centroid"  # face the centroid from the sensor, or as printed from the COD


class ExtractionSettings(Section, frozen=True, kw_only=True):
    """[extraction] how targets are read off the PHD."""

    bin: Annotated[float, msgspec.Meta(ge=0.01, le=1000.0)] = 1.0  # m
    threshold: Positive = 0.5  # mass of a 5 x 5 peak, expected targets


class TimingSettings(Section, frozen=True, kw_only=True):
    """[timing] of rounds and of membership."""

    deadline: Fraction = 0.5  # a round closes at this share of the period at the latest, realtime only
    silent_rounds: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 4  # a silent peer stays a generator this long
    listening_rounds: Annotated[int, msgspec.Meta(ge=0, le=100)] = 2  # at most, for a new incarnation
    overlap: NotNegative = 0.0  # both claims count this close to a contested border, m (docs/decisions/0003)
    estimate_every: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 1  # rounds between two estimates
    interest: Literal["all", "neighbours"] = "all"  # whose gossip an agent hears; with neighbours beacons say who is one
    tile: Annotated[float, msgspec.Meta(ge=10.0, le=1.0e9)] = 35.0  # side of the squares in which beacons are said, m


class AgentConfig(Common, frozen=True, kw_only=True):
    """The settings of an agent process."""

    filter: FilterSettings = FilterSettings()
    birth: BirthSettings = BirthSettings()
    capacity: CapacitySettings = CapacitySettings()
    partition: PartitionSettings = PartitionSettings()
    control: ControlSettings = ControlSettings()
    extraction: ExtractionSettings = ExtractionSettings()
    timing: TimingSettings = TimingSettings()

    @property
    def dice(self) -> int:
        """The seed that all agents share."""
        return self.filter.seed

    def agreed(self) -> Agreed:
        """The settings that all agents must share to compute parts of one PHD and one diagram."""
        timing = {name: getattr(self.timing, name) for name in ("silent_rounds", "overlap", "interest", "tile")}
        own = {"filter": self.filter, "birth": self.birth, "partition": self.partition, "timing": timing}
        return agreed({**common_sections(self), **own})

    def others(self, name: str) -> list[str]:
        """The other agents of the roster, in its order.

        The roster is a hint: it names the agents expected at the start, may be empty, and other agents may join.
        """
        return [other for other in self.members if other != name]

    def gossip_timeout(self, *, missed: bool) -> float:
        """How long an open round waits for missing gossips, s.

        `missed`: some peer was silent in the last round; in lockstep the round then waits a tenth as long. The timeout is a share of the
        time for which the world waits for a command: a round that waited all that time would always send its command too late.
        """
        if self.run.clock == "realtime":
            return self.timing.deadline * self.run.dt / self.run.rate
        return self.timing.deadline * self.run.patience * (0.1 if missed else 1.0)
