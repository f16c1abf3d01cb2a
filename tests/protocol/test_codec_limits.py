"""What the codec refuses by its size and by where it was said, in numbers and not in its own constants."""

import pytest

from protocol import codec
from protocol.fields import Malformed
from protocol.keys import message_key, parse_message_key
from protocol.messages import Beacon

BEACON = Beacon(sender="s1", incarnation=1, tick=3, position=(1.0, 2.0), cod=(2.0, 2.0), power_radius=1.0, reach=8.0, column=2, row=3)


def reason(key: str, payload: bytes) -> str:
    with pytest.raises(Malformed) as caught:
        codec.decode(key, payload)
    return caught.value.reason


def test_a_beacon_counts_in_the_tile_in_which_it_was_said_alone() -> None:
    key, payload = message_key("r", BEACON), codec.encode(BEACON)
    assert key == "covey/r/beacon/2/3/s1" and codec.decode(key, payload) == BEACON
    assert [reason(f"covey/r/beacon/{tile}/s1", payload) for tile in ("3/2", "2/4", "0/3")] == ["sender"] * 3


def test_more_than_half_a_mebibyte_is_refused_unread() -> None:
    assert reason("covey/r/command/s1", bytes(524_289)) == "size"
    assert reason("covey/r/command/s1", bytes(524_288)) == "format"


def test_a_key_longer_than_any_of_ours_is_none() -> None:
    """Three names of 64 letters, two tile numbers of 7 digits and the words between them make at most 256."""
    longest = f"covey/{'r' * 64}/beacon/9999999/9999999/{'s' * 64}"
    assert parse_message_key(longest) is not None
    assert parse_message_key(f"covey/{'r' * 240}/truth") is not None  # 252
    assert parse_message_key(f"covey/{'r' * 245}/truth") is None  # 257
