"""The colours of the page's cells: no two that touch share one, and they stay from frame to frame. The page's own module runs in Node."""

import math
from itertools import combinations

import numpy as np
import shapely

from tests.node import needs_node, node

COLOURS, DIAGRAMS, AGENTS = 9, 100, 24
pytestmark = needs_node


def voronoi(points: np.ndarray, side: float = 100.0) -> list[shapely.Polygon]:
    """The cells of some points in a square, in their order."""
    square = shapely.box(0.0, 0.0, side, side)
    regions = [region.intersection(square) for region in shapely.voronoi_polygons(shapely.MultiPoint(points), extend_to=square).geoms]
    return [next(region for region in regions if region.covers(shapely.Point(point))) for point in points]


def flat(cell: shapely.Polygon) -> list[float]:
    """Corners as a frame says them: x, y, x, y, ... to the centimetre."""
    return [round(value, 2) for corner in list(cell.exterior.coords)[:-1] for value in corner]


def touching(cells: list[shapely.Polygon]) -> list[tuple[int, int]]:
    """Pairs whose common border is longer than 10 cm."""
    return [(i, j) for i, j in combinations(range(len(cells)), 2) if cells[i].intersection(cells[j]).length > 0.1]


def test_no_two_touching_cells_share_a_colour_in_a_hundred_random_diagrams() -> None:
    rng = np.random.default_rng(28)
    diagrams = [voronoi(rng.uniform(0.0, 100.0, (int(rng.integers(2, 49)), 2))) for _ in range(DIAGRAMS)]
    before = [[index % COLOURS for index in range(len(cells))] for cells in diagrams]
    found = node(
        f"data.map(([cells, before]) => colouring(cells, before, {COLOURS}))",
        [[list(map(flat, cells)), numbers] for cells, numbers in zip(diagrams, before)],
        "colouring",
    )
    assert isinstance(found, list)
    pairs = [(cells, touching(cells)) for cells in diagrams]
    assert sum(len(some) for _, some in pairs) > 20 * DIAGRAMS  # there is much to get wrong
    for (cells, some), colours in zip(pairs, found):
        assert len(colours) == len(cells)
        assert [(i, j) for i, j in some if colours[i] == colours[j]] == []


def test_agents_keep_their_colours_from_frame_to_frame_while_they_move() -> None:
    """In 50 steps of 0.5 m almost nobody changes: what changes now had met a cell of its own colour."""
    rng = np.random.default_rng(29)
    points, frames = rng.uniform(5.0, 95.0, (AGENTS, 2)), []
    for _ in range(50):
        points = np.clip(points + 0.5 * rng.normal(size=points.shape) / math.sqrt(2.0), 1.0, 99.0)
        frames.append(voronoi(points))
    start = [index % COLOURS for index in range(AGENTS)]
    history = node(
        f"data[0].reduce((all, cells) => [...all, colouring(cells, all.at(-1), {COLOURS})], [data[1]])",
        [[list(map(flat, cells)) for cells in frames], start],
        "colouring",
    )
    assert isinstance(history, list)
    changes = 0
    for cells, before, after in zip(frames, history, history[1:]):
        changed = [index for index in range(AGENTS) if before[index] != after[index]]
        near = [(i, j) for i, j in combinations(range(AGENTS), 2) if cells[i].distance(cells[j]) < 0.05]
        clashes = {index for pair in near if before[pair[0]] == before[pair[1]] for index in pair}
        assert set(changed) <= clashes
        changes += len(changed)
    assert changes < 40


def test_a_cell_that_is_empty_touches_nobody() -> None:
    assert node("touching(data)", [[0, 0, 1, 0, 1, 1, 0, 1], [], [1, 0, 2, 0, 2, 1, 1, 1], [5, 5, 6, 5, 6, 6]], "colouring") == [
        [2],
        [],
        [0],
        [],
    ]
