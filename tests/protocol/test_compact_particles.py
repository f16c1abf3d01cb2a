"""Particles in few bytes: near what they stand for, the same for owner and receiver, and refused when they make no sense."""

import numpy as np
import pytest

from protocol import codec
from protocol.compact_particles import packed, quantised, unpacked
from protocol.fields import Malformed
from protocol.messages import Gossip


def some(count: int = 80, side: float = 60.0) -> np.ndarray:
    rng = np.random.default_rng(7)
    turns = rng.random(count) * 2.0 * np.pi
    return np.column_stack([rng.random((count, 2)) * side + 20.0, 2.0 * np.cos(turns), 2.0 * np.sin(turns)])


@pytest.mark.parametrize(("side", "step"), [(60.0, 1 / 256), (900.0, 1 / 64)])
def test_places_keep_half_a_step_and_directions_a_thousandth(side: float, step: float) -> None:
    states = some(side=side)
    found, _ = quantised(states, 2.0, "s1", 4)
    assert np.abs(found[:, :2] - states[:, :2]).max() <= 0.5 * step + 1e-5
    assert np.abs(found[:, 2:] - states[:, 2:]).max() <= 2.0 * np.pi / 4096 * 1.01


def test_a_long_and_narrow_cell_is_as_long_as_a_wide_one() -> None:
    states = some(side=900.0) * [1.0, 0.1, 1.0, 1.0]
    found, _ = quantised(states, 2.0, "s1", 4)
    assert np.abs(found[:, :2] - states[:, :2]).max() <= 0.5 / 64 + 1e-5


def test_a_particle_takes_six_bytes_and_what_was_rounded_is_not_rounded_again() -> None:
    once, ids = quantised(some(), 2.0, "s1", 4)
    again, same = quantised(once.astype(float), 2.0, "s1", 4)
    assert len(packed(some(), 2.0)) == 16 + 6 * 80
    assert np.array_equal(once, again) and np.array_equal(ids, same)


def test_ids_ascend_and_are_those_of_one_sender_and_tick() -> None:
    data = packed(some(), 2.0)
    ids = [unpacked(data, sender, tick)[1] for sender, tick in (("s1", 4), ("s1", 5), ("s2", 4))]
    assert all(np.all(each[1:] > each[:-1]) for each in ids)
    assert len(np.unique(np.concatenate(ids))) == 3 * 80


def gossip(data: bytes, **fields: object) -> Gossip:
    claim = {"claim_names": ("s1",), "claim_bytes": bytes(24), "claim_tick": 4, "weight": 0.1}
    return Gossip(
        sender="s1",
        incarnation=1,
        tick=5,
        pose=(0.0, 0.0, 0.0),
        cod=(0.0, 0.0),
        power_radius=0.0,
        unused=0.0,
        particles=data,
        **(claim | fields),
    )  # type: ignore[arg-type]


def test_a_receiver_reads_the_particles_that_the_owner_keeps() -> None:
    states, ids = quantised(some(), 2.0, "s1", 4)
    sent = gossip(packed(some(), 2.0), states_bytes=states.tobytes(), ids_bytes=ids.tobytes())
    payload = codec.encode(sent)
    heard = codec.decode("covey/r/gossip/s1", payload)
    assert isinstance(heard, Gossip) and np.array_equal(heard.states, states) and np.array_equal(heard.ids, ids)
    assert len(payload) < 6 * 80 + 500


@pytest.mark.parametrize("data", [b"123", packed(some(), 2.0)[:-1], b"\xff" * 22])
def test_bytes_that_are_no_particles_are_refused(data: bytes) -> None:
    with pytest.raises(Malformed):
        codec.decode("covey/r/gossip/s1", codec.encode(gossip(data)))
