"""The cases of the golden record: three swarms, what they hear, what happens to them, and five seeds each."""

from typing import Any, NamedTuple

import msgspec

from deploy.scenario import FaultSettings, Scenario, resolve

TICKS = 40
SEEDS = (1, 2, 3, 4, 5)
DETAILED = 1  # the seed whose record says also which agents and which fields
SWARMS: dict[str, tuple[str, dict[str, Any]]] = {
    "efficacy": ("efficacy", {"team.composition": "4"}),
    "20E10G": ("heterogeneity", {}),
    "anisotropic": ("anisotropic", {"team.composition": "R3,S3", "arena.width": 30.0, "arena.height": 30.0}),
}
INTERESTS = ("all", "neighbours")


def _fault(at: float, verb: str, who: str = "", value: float | None = None, seconds: float | None = None, **options: Any) -> FaultSettings:
    return FaultSettings(at=at, verb=verb, who=who, value=value, seconds=seconds, options=options)


TROUBLES: dict[str, tuple[str, tuple[FaultSettings, ...]]] = {  # clock, faults
    "lockstep": ("lockstep", ()),
    "realtime": ("realtime", (_fault(0.0, "delay", value=0.02, jitter=0.12),)),  # one message in seven comes after the deadline
    "loss": ("lockstep", (_fault(0.0, "drop", value=0.1),)),
    "deaths": (
        "realtime",
        (_fault(2.0, "kill", "10%", seconds=4.5), _fault(3.0, "partition", "20%", seconds=2.5), _fault(4.0, "pause", "2", seconds=2.5)),
    ),
}
OSPA_SEEDS = (1, 2, 3, 4, 5, 6)
PARTITIONS = ("power", "voronoi", "voronoi-cod")


class Case(NamedTuple):
    """One run."""

    swarm: str
    interest: str
    trouble: str
    seed: int

    def __str__(self) -> str:
        return f"{self.group}/{self.trouble}/{self.seed}"

    @property
    def group(self) -> str:
        """Name of the file that holds it."""
        return f"{self.swarm}-{self.interest}"

    @property
    def clock(self) -> str:
        """Of the world."""
        return TROUBLES[self.trouble][0]

    def scenario(self) -> Scenario:
        """What is played."""
        name, options = SWARMS[self.swarm]
        dt = 0.25
        more = {"run.seed": self.seed, "run.dt": dt, "run.seconds": TICKS * dt, "timing.interest": self.interest, "network.lease": 2.0}
        return msgspec.structs.replace(resolve(name, {**options, **more}), faults=TROUBLES[self.trouble][1])


def case_of(text: str) -> Case:
    """The case of such a name as efficacy-all/loss/3; raises ValueError."""
    for case in CASES:
        if str(case) == text:
            return case
    raise ValueError(f"{text}: should be {'|'.join(SWARMS)}-{'|'.join(INTERESTS)}/{'|'.join(TROUBLES)}/{SEEDS[0]}..{SEEDS[-1]}")


def ospa_scenario(partition: str, seed: int) -> Scenario:
    """A run of 200 ticks of team 2 (24 sensors) whose steady OSPA is kept."""
    options = {"team.composition": "2", "run.dt": 0.5, "run.seconds": 100.0, "run.seed": seed, "partition.kind": partition}
    return resolve("efficacy", options)


CASES = [Case(swarm, interest, trouble, seed) for swarm in SWARMS for interest in INTERESTS for trouble in TROUBLES for seed in SEEDS]
