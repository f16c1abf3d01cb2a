"""Random streams: reference values, statistics, and independence of the order of calls."""

import math
import subprocess
import sys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from protocol.random_streams import NORMAL_BOUND, normal, random_key, scramble, stream, uniform

words64 = st.integers(0, 2**64 - 1)
COUNTER = np.arange(200_000, dtype=np.uint64)


def test_scramble_of_the_states_of_splitmix64_gives_its_published_outputs() -> None:
    golden, mask = 0x9E3779B97F4A7C15, 2**64 - 1
    from_zero = np.array([number * golden & mask for number in range(5)], dtype=np.uint64)
    expected = [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F, 0xF88BB8A8724C81EC, 0x1B39896A51A8749B]
    assert scramble(from_zero, 0).tolist() == expected
    from_1234567 = np.array([1234567 + number * golden & mask for number in range(5)], dtype=np.uint64)
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431, 16408922859458223821]
    assert scramble(from_1234567, 0).tolist() == expected


@given(words64, words64)
def test_the_salt_is_mixed_in_by_exclusive_or(word: int, salt: int) -> None:
    assert scramble(np.array([word], dtype=np.uint64), salt) == scramble(np.array([word ^ salt], dtype=np.uint64), 0)


def test_scramble_leaves_its_argument_alone() -> None:
    words = np.arange(4, dtype=np.uint64)
    scramble(words, 99)
    assert words.tolist() == [0, 1, 2, 3]


def test_nothing_scrambles_to_nothing() -> None:
    nothing = np.empty(0, dtype=np.uint64)
    assert len(scramble(nothing, 1)) == len(uniform(nothing)) == len(normal(nothing)) == 0


def test_keys_do_not_change_between_releases() -> None:
    """A recorded run can be replayed only while these stay what they are."""
    assert random_key() == 0x9E3779B97F4A7C15
    assert random_key(0) == 0x6E789E6AA1B965F4  # the second output of splitmix64 from 0: one golden step, then the finaliser
    assert random_key(1, "noise", 7) == 5169545593936622748
    assert stream(1, "targets", 0).integers(0, 2**62, 2).tolist() == [2216023258362977889, 399713934593078357]


def test_keys_differ_by_part_by_order_and_by_number_of_parts() -> None:
    tuples = [
        (1,),
        (2,),
        (1, 2),
        (2, 1),
        (1, 2, 0),
        ("a",),
        ("b",),
        ("a", "b"),
        ("b", "a"),
        (1, "a"),
        ("a", 1),
        (-1,),
        (2**63,),
        (0,),
        (0, 0),
    ]
    assert len({random_key(*parts) for parts in tuples}) == len(tuples)


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1))
def test_numpy_integers_make_the_same_key_as_plain_ones(first: int, second: int) -> None:
    assert random_key(np.int64(first), "x", np.uint64(second)) == random_key(first, "x", second)


def test_keys_and_hashes_do_not_depend_on_pythonhashseed() -> None:
    program = "from protocol.random_streams import random_key, stream; print(random_key(3, 'births', 4), stream(3, 'births', 4).random())"
    found = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": ":".join(sys.path)},
            capture_output=True,
            check=True,
            timeout=60,
        ).stdout
        for seed in ("0", "1", "4242")
    }
    assert found == {f"{random_key(3, 'births', 4)} {stream(3, 'births', 4).random()}\n".encode()}


def test_a_stream_is_the_same_whatever_was_drawn_before_and_differs_by_purpose_and_index() -> None:
    stream(5, "other").random(1000)
    assert stream(5, "targets", 2).random() == stream(5, "targets", 2).random()
    firsts = {
        stream(*parts).random() for parts in [(5, "targets"), (5, "targets", 1), (5, "targets", 2), (5, "starts", 2), (6, "targets", 2)]
    }
    assert len(firsts) == 5


def test_uniform_maps_the_ends_of_the_words_into_the_half_open_interval() -> None:
    ends = np.array([0, 2**11 - 1, 2**11, 2**63, 2**64 - 1], dtype=np.uint64)
    assert uniform(ends).tolist() == [0.0, 0.0, 2.0**-53, 0.5, 1.0 - 2.0**-53]


def test_uniform_variates_fill_the_interval_evenly() -> None:
    draws = uniform(scramble(COUNTER, random_key(1, "test")))
    counts = np.histogram(draws, bins=100, range=(0.0, 1.0))[0]
    chi_squared = float(np.sum((counts - 2000.0) ** 2 / 2000.0))
    assert 45.0 < chi_squared < 175.0  # 99 degrees of freedom: mean 99, standard deviation 14
    assert abs(np.mean(draws) - 0.5) < 5.0 * math.sqrt(1.0 / 12.0 / len(draws))
    assert abs(np.corrcoef(draws[:-1], draws[1:])[0, 1]) < 5.0 / math.sqrt(len(draws))


def test_two_salts_give_uncorrelated_variates() -> None:
    one, two = uniform(scramble(COUNTER, random_key(1, 10))), uniform(scramble(COUNTER, random_key(1, 11)))
    assert abs(np.corrcoef(one, two)[0, 1]) < 5.0 / math.sqrt(len(COUNTER))


def test_normal_variates_have_mean_0_variance_1_no_skew_and_kurtosis_2_7() -> None:
    draws = normal(scramble(COUNTER, random_key(2, "test")))
    error = 5.0 / math.sqrt(len(draws))
    assert abs(np.mean(draws)) < error
    assert abs(np.mean(draws**2) - 1.0) < error * math.sqrt(1.7)  # variance of z^2 is the kurtosis minus 1
    assert abs(np.mean(draws**3)) < error * 4.0
    assert abs(np.mean(draws**4) - 2.7) < error * 6.0
    assert np.abs(draws).max() < NORMAL_BOUND


def test_normal_is_bounded_and_symmetric_at_its_very_ends() -> None:
    low, high = normal(np.array([0, 2**64 - 1], dtype=np.uint64)).tolist()
    assert low == -high
    assert NORMAL_BOUND * (1.0 - 1e-4) < high < NORMAL_BOUND
    assert 2.0 * math.sqrt(3.0) == NORMAL_BOUND


def test_normal_sums_the_four_quarters_of_a_word() -> None:
    quarters = np.array([0x0001_0000_0000_0000, 0x0000_0001_0000_0000, 0x0000_0000_0001_0000, 0x0000_0000_0000_0001], dtype=np.uint64)
    assert normal(quarters).tolist() == [(1.0 - 131070.0) * (math.sqrt(3.0) / 65536.0)] * 4
