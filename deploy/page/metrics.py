"""Metrics of a swarm for Prometheus: one endpoint for all agents, every sample with the name of the run."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from deploy.page.picture import KnownAgent, Picture
from deploy.scenario import has_targets
from deploy.scoring.scores import Score
from protocol.observer_messages import Estimate

CONTENT_TYPE = CONTENT_TYPE_LATEST
STATES = ("waiting", "alive", "listening", "silent", "paused", "dead")
COMPARED = ("ospa_meters", "gospa_meters", "targets", "targets_in_view")  # families that need true targets
Sample = tuple[dict[str, str], float]


class Family(NamedTuple):
    """One metric: its name without `covey_`, its kind, its help, and a value for each set of labels."""

    name: str
    kind: Literal["gauge", "counter"]
    text: str
    samples: list[Sample]


@dataclass
class PageFigures:
    """What the page's server counts of itself."""

    clients: int = 0
    frames: int = 0
    frame_bytes: int = 0
    dropped: int = 0


class SwarmCollector:
    """The metrics of one moment, as a collector of prometheus_client."""

    def __init__(self, picture: Picture, score: Score | None, page: PageFigures) -> None:
        self._picture, self._score, self._page = picture, score, page

    def collect(self) -> Iterator[GaugeMetricFamily | CounterMetricFamily]:
        """All families, without `COMPARED` where there are no true targets; every sample carries the name of the run."""
        run, compares = self._picture.scenario.run.name, has_targets(self._picture.scenario)
        for family in (*_swarm(self._picture), *_scores(self._score), *_agents(self._picture), *_page(self._page)):
            if family.name in COMPARED and not compares:
                continue
            labels = ["run", *(family.samples[0][0] if family.samples else ())]
            make = GaugeMetricFamily if family.kind == "gauge" else CounterMetricFamily
            metric = make(f"covey_{family.name}", family.text, labels=labels)
            for named, value in family.samples:
                metric.add_metric([run, *named.values()], value)
            yield metric


def metrics_page(picture: Picture, score: Score | None, page: PageFigures) -> bytes:
    """The text that Prometheus scrapes, of type `CONTENT_TYPE`."""
    registry = CollectorRegistry()
    registry.register(SwarmCollector(picture, score, page))
    return generate_latest(registry)


def _swarm(picture: Picture) -> Iterator[Family]:
    states = [known.state for known in picture.agents.values()]
    yield Family("world_time_seconds", "gauge", "Time of the world.", [({}, picture.time)])
    yield Family("tick", "gauge", "Newest tick of the world.", [({}, picture.truth.tick if picture.truth else -1)])
    yield Family("agents", "gauge", "Agents by state.", [({"state": state}, states.count(state)) for state in STATES])
    yield Family("messages_total", "counter", "Messages heard.", [({}, picture.messages)])
    yield Family("message_bytes_total", "counter", "Payload of the messages heard.", [({}, picture.bytes)])
    rejected = [({"sender": sender, "reason": reason}, count) for (sender, reason), count in sorted(picture.rejected.items())]
    yield Family(
        "rejected_total",
        "counter",
        "Messages that the monitor refused; (other): their sender is no known agent.",
        [(labels, float(count)) for labels, count in rejected],
    )


def _scores(score: Score | None) -> Iterator[Family]:
    if score is None:
        return
    yield Family("ospa_meters", "gauge", "OSPA distance of estimates and targets (order 1, cut-off study.cutoff).", [({}, score.ospa)])
    yield Family(
        "gospa_meters", "gauge", "GOSPA distance of estimates and targets (order 1, alpha 2, cut-off study.cutoff).", [({}, score.gospa)]
    )
    yield Family("targets", "gauge", "True targets.", [({}, score.targets)])
    yield Family("targets_in_view", "gauge", "True targets in some field of view.", [({}, score.in_view)])
    yield Family("targets_estimated", "gauge", "Targets that the agents report.", [({}, score.estimated)])
    yield Family("mass", "gauge", "Expected targets, sum over the agents.", [({}, score.mass)])
    yield Family("hole_ratio", "gauge", "Share of the arena in no cell.", [({}, score.hole)])
    yield Family(
        "overlap_ratio",
        "gauge",
        "Sum of all cells minus the ground that they cover together, as a share of the arena; may be above 1.",
        [({}, score.overlap)],
    )


def _agents(picture: Picture) -> Iterator[Family]:
    spoken = [(known, known.estimate) for known in picture.agents.values() if known.estimate is not None]
    living = [(known, estimate) for known, estimate in spoken if known.alive]  # a dead agent owns nothing
    up = [({"agent": known.name}, float(known.alive)) for known in picture.agents.values()]
    yield Family("agent_up", "gauge", "1 while the agent's token is up.", up)
    ages = [(known.name, picture.age(known)) for known in picture.agents.values()]
    yield Family(
        "agent_age_seconds", "gauge", "Age of the last gossip, s of the world.", [({"agent": n}, a) for n, a in ages if a is not None]
    )
    yield Family("agent_mass", "gauge", "Expected targets in the agent's cell.", [({"agent": k.name}, e.mass) for k, e in living])
    yield Family("agent_load", "gauge", "Expected targets in the agent's footprint.", [({"agent": k.name}, e.load) for k, e in living])
    yield Family("agent_unused_square_meters", "gauge", "Unused capacity U.", [({"agent": k.name}, e.unused) for k, e in living])
    yield Family("agent_round_seconds", "gauge", "How long the last round took.", [({"agent": k.name}, e.round_seconds) for k, e in living])
    yield from _agent_counters(spoken)


def _agent_counters(spoken: list[tuple[KnownAgent, Estimate]]) -> Iterator[Family]:
    """A family for each counter that agents report; `rejected.format` is the family `rejected` with the reason `format`."""
    families: dict[str, list[Sample]] = {}
    for known, estimate in spoken:
        for name, count in sorted(estimate.counters.items()):
            family, _, reason = name.partition(".")
            families.setdefault(re.sub(r"[^a-zA-Z0-9]", "_", family), []).append(({"agent": known.name, "reason": reason}, count))
    for family, samples in sorted(families.items()):
        if not any(labels["reason"] for labels, _ in samples):
            samples = [({"agent": labels["agent"]}, count) for labels, count in samples]
        yield Family(f"agent_{family}_total", "counter", f"The agents' own counter {family}.", samples)


def _page(page: PageFigures) -> Iterator[Family]:
    yield Family("page_clients", "gauge", "Browsers that look.", [({}, page.clients)])
    yield Family("page_frames_total", "counter", "Frames encoded.", [({}, page.frames)])
    yield Family("page_frame_bytes_total", "counter", "Size of the frames encoded.", [({}, page.frame_bytes)])
    yield Family("page_frames_dropped_total", "counter", "Frames that slow browsers did not get.", [({}, page.dropped)])
