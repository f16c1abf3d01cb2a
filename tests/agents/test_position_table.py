"""The table of whereabouts keeps the newest word of each and no hole."""

import numpy as np

from agents.config import AgentConfig
from agents.interest.position_table import POSITION_ROW, PositionTable, beacon_row
from protocol.messages import Beacon


def row(number: float) -> bytes:
    return POSITION_ROW.pack(*[number] * 6)


def firsts(places: PositionTable) -> dict[str, float]:
    """The first number of each row."""
    return dict(zip(places.names, places.table(row(-1.0))[:, 0].tolist()))


def test_the_newest_word_counts() -> None:
    places = PositionTable(AgentConfig())
    for name, tick, number in (("s1", 3, 1.0), ("s2", 3, 2.0), ("s1", 2, 9.0), ("s2", 3, 4.0), ("s1", 5, 6.0)):
        places.put(name, tick, row(number))
    assert firsts(places) == {"s1": 6.0, "s2": 4.0}


def test_the_own_row_comes_last_however_many_there_are() -> None:
    places = PositionTable(AgentConfig())
    for number in range(50):
        places.put(f"s{number}", 0, row(float(number)))
        table = places.table(row(-1.0))
        assert table.shape == (number + 2, 6) and table[-1].tolist() == [-1.0] * 6
        assert table[:-1, 0].tolist() == list(map(float, range(number + 1)))


def test_after_any_comings_and_goings_the_rows_are_those_of_a_dictionary() -> None:
    for seed in range(20):
        print(f"seed {seed}")
        rng, places = np.random.default_rng(seed), PositionTable(AgentConfig())
        expected: dict[str, tuple[int, float]] = {}
        for tick in range(200):
            name, number = f"s{rng.integers(12)}", float(rng.integers(1000))
            if rng.random() < 0.3:
                places.remove(name)
                expected.pop(name, None)
            elif rng.random() < 0.3:
                many = [(f"s{other}", tick - int(rng.integers(3)), float(rng.integers(1000))) for other in rng.integers(12, size=5)]
                for other, said, number in many:
                    places.put(other, said, row(number))
                    if said >= expected.get(other, (said, 0.0))[0]:
                        expected[other] = said, number
            else:
                places.put(name, tick, row(number))
                expected[name] = tick, number
            if tick % 20 == 0:
                version, old = places.version, {name for name, (said, _) in expected.items() if said < tick - 10}
                assert set(places.forget_outside(tick - 10, tick)) == old and (places.version != version) == bool(old)
                expected = {name: word for name, word in expected.items() if name not in old}
            assert firsts(places) == {name: number for name, (_, number) in expected.items()} and len(places) == len(expected)
            assert all((f"s{number}" in places) == (f"s{number}" in expected) for number in range(12))


def test_a_row_says_the_generator_of_the_diagram_in_use() -> None:
    for kind, generator in (("power", (3.0, 4.0, 5.0)), ("voronoi-cod", (3.0, 4.0, 0.0)), ("voronoi", (1.0, 2.0, 0.0))):
        beacon = Beacon(
            sender="s1", incarnation=1, tick=0, position=(1.0, 2.0), cod=(3.0, 4.0), power_radius=5.0, reach=6.0, column=0, row=0
        )
        assert POSITION_ROW.unpack(beacon_row(beacon, kind)) == (1.0, 2.0, 6.0, *generator)


def test_a_row_of_a_tick_that_is_still_to_come_is_forgotten_as_well() -> None:
    places = PositionTable(AgentConfig())
    for name, tick in (("s1", 5), ("s2", 21), ("s3", 20)):
        places.put(name, tick, row(1.0))
    assert places.forget_outside(3, 20) == ["s2"] and places.forget_outside(4, 20) == [] and places.forget_outside(6, 20) == ["s1"]
