"""What the monitor measures, in the text form that Prometheus reads (version 0.0.4). One endpoint for the whole swarm."""

from collections.abc import Iterable
from dataclasses import dataclass

from deploy.page.picture import Picture
from deploy.scoring.scorer import Score

STATES = ("waiting", "alive", "listening", "silent", "paused", "dead")
Sample = tuple[dict[str, str], float]


@dataclass
class PageFigures:
    """What the page's server counts of itself."""

    clients: int = 0
    frames: int = 0
    frame_bytes: int = 0
    dropped: int = 0


def prometheus_text(picture: Picture, score: Score | None, page: PageFigures) -> str:
    """All figures; every sample carries the run's name."""
    lines: list[str] = []
    for name, kind, text, samples in [*_swarm(picture, score), *_agents(picture), *_page(page)]:
        lines += [f"# HELP covey_{name} {text}", f"# TYPE covey_{name} {kind}"]
        lines += [_line(f"covey_{name}", {"run": picture.scenario.run.name, **labels}, value) for labels, value in samples]
    return "\n".join(lines) + "\n"


def _swarm(picture: Picture, score: Score | None) -> Iterable[tuple[str, str, str, list[Sample]]]:
    states = [known.state for known in picture.agents.values()]
    yield "world_time_seconds", "gauge", "Time of the world.", [({}, picture.time)]
    yield "tick", "gauge", "Newest tick of the world.", [({}, picture.truth.tick if picture.truth else -1)]
    yield "agents", "gauge", "Agents by state.", [({"state": state}, states.count(state)) for state in STATES]
    yield "messages_total", "counter", "Messages heard.", [({}, picture.messages)]
    yield "message_bytes_total", "counter", "Payload of the messages heard.", [({}, picture.bytes)]
    rejected = [({"sender": sender, "reason": reason}, count) for (sender, reason), count in sorted(picture.rejected.items())]
    yield "rejected_total", "counter", "Messages that the monitor refused.", [(labels, float(count)) for labels, count in rejected]
    if score is None:
        return
    yield "ospa_meters", "gauge", "OSPA distance of estimates and targets (cutoff 10 m, order 1).", [({}, score.ospa)]
    yield "gospa_meters", "gauge", "GOSPA distance of estimates and targets (cutoff 10 m, order 1, alpha 2).", [({}, score.gospa)]
    yield "targets", "gauge", "True targets.", [({}, score.targets)]
    yield "targets_in_view", "gauge", "True targets in some field of view.", [({}, score.in_view)]
    yield "targets_estimated", "gauge", "Targets that the agents report.", [({}, score.estimated)]
    yield "mass", "gauge", "Expected targets, sum over the agents.", [({}, score.mass)]
    yield "hole_ratio", "gauge", "Share of the arena in no cell.", [({}, score.hole)]
    yield "overlap_ratio", "gauge", "Share of the arena in more than one cell.", [({}, score.overlap)]


def _agents(picture: Picture) -> Iterable[tuple[str, str, str, list[Sample]]]:
    spoken = [(known, known.estimate) for known in picture.agents.values() if known.estimate is not None]
    up = [({"agent": known.name}, float(known.alive)) for known in picture.agents.values()]
    yield "agent_up", "gauge", "1 while the agent's token is up.", up
    ages = [(known.name, picture.age(known)) for known in picture.agents.values()]
    yield "agent_age_seconds", "gauge", "Age of the last gossip, s of the world.", [({"agent": n}, a) for n, a in ages if a is not None]
    yield "agent_mass", "gauge", "Expected targets in the agent's cell.", [({"agent": k.name}, e.mass) for k, e in spoken]
    yield "agent_load", "gauge", "Expected targets in the agent's footprint.", [({"agent": k.name}, e.load) for k, e in spoken]
    yield "agent_unused_square_meters", "gauge", "Unused capacity U.", [({"agent": k.name}, e.unused) for k, e in spoken]
    yield "agent_round_seconds", "gauge", "How long the last round took.", [({"agent": k.name}, e.round_seconds) for k, e in spoken]
    counters: dict[str, list[Sample]] = {}
    for known, estimate in spoken:
        for name, count in sorted(estimate.counters.items()):
            family, _, reason = name.partition(".")
            labels = {"agent": known.name, **({"reason": reason} if reason else {})}
            counters.setdefault("".join(c if c.isalnum() else "_" for c in family), []).append((labels, count))
    for family, samples in sorted(counters.items()):
        yield f"agent_{family}_total", "counter", f"The agents' own counter {family}.", samples


def _page(page: PageFigures) -> Iterable[tuple[str, str, str, list[Sample]]]:
    yield "page_clients", "gauge", "Browsers that look.", [({}, page.clients)]
    yield "page_frames_total", "counter", "Frames encoded.", [({}, page.frames)]
    yield "page_frame_bytes_total", "counter", "Size of the frames encoded.", [({}, page.frame_bytes)]
    yield "page_frames_dropped_total", "counter", "Frames that slow browsers did not get.", [({}, page.dropped)]


def _line(name: str, labels: dict[str, str], value: float) -> str:
    inside = ",".join(f'{label}="{_escaped(text)}"' for label, text in labels.items())
    return f"{name}{{{inside}}} {float(value)!r}"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("\n", "\\n").replace('"', '\\"')
