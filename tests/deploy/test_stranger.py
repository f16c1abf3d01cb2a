"""The example agent of another make computes what ours compute, though it shares nothing with them."""

import importlib.util
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import msgpack
import numpy as np
import pytest
import zenoh

from agents.config import AgentConfig, FilterSettings
from agents.coverage import cells
from agents.tracking import phd
from agents.tracking.claims import make_claim, owned
from agents.tracking.particles import Particles, unlabelled
from agents.tracking.step import Step
from protocol.codec import encode
from protocol.geometry import polygon_area, rectangle
from protocol.keys import message_key
from protocol.message import Message
from protocol.messages import Gossip, Hello, Observation
from protocol.random_streams import random_key
from protocol.settings import ArenaSettings

FILE = Path(__file__).parents[2] / "deploy" / "examples" / "stranger.py"


@pytest.fixture(scope="module")
def stranger() -> ModuleType:
    spec = importlib.util.spec_from_file_location("stranger", FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows_of(particles: Particles) -> list[tuple[float, ...]]:
    weights, ids = particles.weights.tolist(), particles.ids.tolist()
    return [(*state, weight, number) for state, weight, number in zip(particles.states.tolist(), weights, ids)]


def test_it_is_short_enough_to_be_read() -> None:
    assert len(FILE.read_text(encoding="utf-8").splitlines()) < 250


@pytest.mark.parametrize("border", ["cross", "reflect"])
def test_its_particles_move_as_ours_do(stranger: ModuleType, border: str) -> None:
    config = AgentConfig(arena=ArenaSettings(width=30.0, height=20.0), filter=FilterSettings(seed=2**62 + 5, border=border))  # type: ignore[arg-type]
    rng = np.random.default_rng(5)
    states = np.column_stack([rng.uniform(0.0, 30.0, 200), rng.uniform(0.0, 20.0, 200), rng.normal(0.0, 2.0, (200, 2))])
    particles = unlabelled(states, np.full(200, 0.25), rng.integers(0, 2**64, 200, dtype=np.uint64))
    moved = phd.predict(particles, Step(config, 17))
    ours = [row for row in rows_of(moved) if row[4] > 0.0]
    assert stranger.move(rows_of(particles), 17, config.shared_settings()) == ours
    assert len(ours) == 200 if border == "reflect" else len(ours) < 200


def test_its_keys_are_ours(stranger: ModuleType) -> None:
    assert stranger.random_key(2**63 - 1, "north", 12345) == random_key(2**63 - 1, "north", 12345)


def test_its_cells_and_claims_are_ours(stranger: ModuleType) -> None:
    """Discs of all sizes, two in one place, names of two lengths."""
    rng, arena = np.random.default_rng(11), ArenaSettings(width=40.0, height=40.0)
    points, radii = rng.uniform(0.0, 40.0, (12, 2)), rng.uniform(0.0, 12.0, 12)
    points[7], radii[7] = points[2], radii[2]
    names = [f"s{number}" for number in range(1, 13)]
    diagram = [(name, *point, radius) for name, point, radius in zip(names, points.tolist(), radii.tolist())]
    corners = [tuple(corner) for corner in rectangle(40.0, 40.0).tolist()]
    grid = np.stack(np.meshgrid(np.arange(0.0, 40.1, 2.0), np.arange(0.0, 40.1, 2.0)), axis=-1).reshape(-1, 2)
    areas = []
    for number, row in enumerate(diagram):
        polygon, claim = stranger.power_cell(row, [other for other in diagram if other is not row], corners)
        ours = cells.cut(number, points, radii, rectangle(40.0, 40.0))
        areas.append(polygon_area(np.array(polygon).reshape(-1, 2)))
        assert areas[-1] == pytest.approx(polygon_area(ours.polygon), abs=1e-9)
        if areas[-1] == 0.0:
            continue
        assert claim[0] == row and {other[0] for other in claim} == {names[bound] for bound in ours.bounding}
        said = tuple(other[0] for other in claim)
        stated = make_claim(said, np.array([other[1:] for other in claim]))
        assert [stranger.owns(claim, x, y) for x, y in grid.tolist()] == owned(grid, stated, arena).tolist()
    assert sum(areas) == pytest.approx(1600.0) and areas[7] == 0.0


class Session:
    """A session that keeps what is published."""

    def __init__(self) -> None:
        self.said: list[tuple[str, dict[str, Any]]] = []

    def put(self, key: str, payload: bytes, **options: object) -> None:
        self.said.append((key, msgpack.unpackb(payload)))


def sample(message: Message) -> SimpleNamespace:
    payload = SimpleNamespace(to_bytes=lambda: encode(message))
    return SimpleNamespace(key_expr=message_key("demo", message), payload=payload, kind=zenoh.SampleKind.PUT)


def test_it_takes_what_a_body_of_its_own_says_and_passes_over_its_own_messages(stranger: ModuleType) -> None:
    """A body has the name of its agent."""
    session = Session()
    agent = stranger.Stranger(session, "demo", "s3", [])
    config = AgentConfig()
    agent.take(sample(Hello(sender="s1", incarnation=1, settings=config.shared_settings())))
    agent.take(sample(Gossip(sender="s3", incarnation=1, tick=4, pose=(1.0, 1.0, 0.0), cod=(1.0, 1.0), power_radius=1.0, unused=1.0)))
    assert agent.gossips == {} and session.said == []
    agent.take(sample(Observation(sender="s3", recipient="s3", incarnation=1, tick=5, time=1.25, pose=(1.0, 2.0, 0.0))))
    [(key, gossip)] = session.said
    assert (key, gossip["tick"], gossip["pose"]) == ("covey/demo/gossip/s3", 5, [1.0, 2.0, 0.0])


def test_it_awaits_a_peer_that_it_has_never_heard_only_as_a_newcomer(stranger: ModuleType) -> None:
    agent = stranger.Stranger(Session(), "demo", "s3", [])
    agent.settings, agent.tick, agent.alive, agent.last = (
        {"timing": {"silent_rounds": 4}},
        9,
        {("s1", 1), ("s2", 1), ("s4", 1)},
        {"s1": 5, "s4": 4},
    )
    assert agent.awaited() == {"s1", "s2"}
    agent.listening = False
    assert agent.awaited() == {"s1"}


def test_a_draw_keeps_the_mass_and_gives_every_particle_an_id_of_its_own(stranger: ModuleType) -> None:
    rng = np.random.default_rng(3)
    particles = [(*row, weight, number) for number, (row, weight) in enumerate(zip(rng.normal(size=(50, 4)).tolist(), rng.random(50)))]
    drawn = stranger.draw(particles, {"particles_per_target": 4, "least_particles": 30, "most_particles": 2000})
    assert len(drawn) == round(4 * sum(row[4] for row in particles)) and len({row[4] for row in drawn}) == 1
    assert sum(row[4] for row in drawn) == pytest.approx(sum(row[4] for row in particles))
    ids = [row[5] for row in drawn]
    assert ids == sorted(set(ids)) and stranger.draw([], {}) == []
