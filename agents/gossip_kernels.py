"""The compiled reader: gossips from their bytes into the table of `words`, for rounds in which nothing is out of the ordinary.

Whatever it takes `codec.decode` takes with the same values, and `Neighbours.hear` believes; what it does not take is for them to judge.
It knows the one layout that our encoder writes: the fields in their order, whole numbers in the shortest form, the rest as it is.
"""

import math

import numpy as np

from agents.numba_cache import cached
from agents.words import COS, DETECTIONS, EAST, KIND, NORTH, PARTICLES, RADIUS, SILENT, WEIGHT, X, Y
from protocol.codec import MAX_BYTES
from protocol.fields import FARTHEST, LARGEST_AREA, MAX_DETECTIONS, MAX_NAMES, MAX_PARTICLES

# tokens, see `calm`; as numbers of numpy, for each of Python's is a type of its own to numba, which compiled `_after` for every one
HEAD, TICK, POSE, COD, POWER_RADIUS, UNUSED, SEEN, SCANNED, CLAIM_TICK, NAMES, CLAIM, VIEW, MASS, STATES, IDS, INCARNATION = np.arange(16)
SCAN_AT, SCAN_COUNT, STATES_AT, COUNT, IDS_AT, STAMP, CUT = range(7)  # columns of the spans: bytes from the start, rows, claim tick, view


@cached
def _after(data: np.ndarray, at: int, end: int, layout: tuple, token: np.integer) -> int:
    """The place after a token that must stand at `at`; -1: it does not, or `at` was -1."""
    tokens, ends = layout
    first = ends[token - 1] if token > 0 else 0
    size = ends[token] - first
    if at < 0 or at + size > end:
        return -1
    for k in range(size):
        if data[at + k] != tokens[first + k]:
            return -1
    return at + size


@cached
def _big_endian(data: np.ndarray, at: int, size: int | np.int64) -> np.uint64:
    value = np.uint64(0)
    for k in range(size):
        value = (value << np.uint64(8)) | np.uint64(data[at + k])
    return value


@cached
def _whole(data: np.ndarray, at: int, end: int) -> tuple:
    """A whole number from 0 to 2**63 - 1, and the place after it."""
    if at < 0 or at >= end:
        return 0, -1
    head = np.int64(data[at])
    if head < 0x80:
        return head, at + 1
    size = 1 << (head - 0xCC) if 0xCC <= head <= 0xCF else 0
    if size == 0 or at + 1 + size > end:
        return 0, -1
    value = np.int64(_big_endian(data, at + 1, size))
    return value, at + 1 + size if value >= 0 else -1


@cached
def _real(data: np.ndarray, at: int, end: int, most: float) -> tuple:
    """A number of at most `most`, and the place after it."""
    if at < 0 or at + 9 > end or data[at] != 0xCB:
        return 0.0, -1
    value = np.uint64(_big_endian(data, at + 1, 8)).view(np.float64)
    return value, at + 9 if abs(value) <= most else -1


@cached
def _bytes(data: np.ndarray, at: int, end: int, size: int, most: int) -> tuple:
    """Where the bytes of an array begin, how many rows of `size` bytes they are, `most` at most, and the place after them."""
    if at < 0 or at >= end:
        return 0, 0, -1
    head = np.int64(data[at])
    wide = 1 << (head - 0xC4) if 0xC4 <= head <= 0xC6 else 0
    if wide == 0 or at + 1 + wide > end:
        return 0, 0, -1
    length, first = np.int64(_big_endian(data, at + 1, wide)), at + 1 + wide
    rows = length // size
    if first + length > end or rows * size != length or rows > most:
        return 0, 0, -1
    return first, rows, first + length


@cached
def _text(data: np.ndarray, at: int, end: int) -> tuple:
    """Where a short ASCII text begins, its length, and the place after it."""
    if at < 0 or at >= end:
        return 0, 0, -1
    head, first = np.int64(data[at]), at + 1
    if 0xA0 <= head <= 0xBF:
        length = head - 0xA0
    elif head == 0xD9 and first < end:
        length, first = np.int64(data[first]), first + 1
    else:
        return 0, 0, -1
    if first + length > end:
        return 0, 0, -1
    for k in range(first, first + length):
        if data[k] >= 0x80:
            return 0, 0, -1
    return first, length, first + length


@cached
def _same(data: np.ndarray, first: int, length: int, spelled: np.ndarray, begin: int, end: int) -> bool:
    if length != end - begin:
        return False
    same = True
    for k in range(length):
        same &= data[first + k] == spelled[begin + k]
    return same


@cached
def _names(data: np.ndarray, at: int, end: int, sender: tuple[int, int]) -> tuple:
    """How many names there are, of which the first must be the sender's, and the place after them."""
    if at < 0 or at >= end:
        return 0, -1
    head, place = np.int64(data[at]), at + 1
    if 0x90 <= head <= 0x9F:
        number = head - 0x90
    elif head == 0xDC and at + 3 <= end:
        number, place = np.int64(_big_endian(data, place, 2)), at + 3
    else:
        return 0, -1
    if number > MAX_NAMES:
        return 0, -1
    for n in range(number):
        first, length, place = _text(data, place, end)
        if place < 0 or (n == 0 and not _same(data, first, length, data, sender[0], sender[1])):
            return 0, -1
    return number, place


@cached
def _singles_fit(data: np.ndarray, first: int, size: int) -> bool:
    """Whether these bytes are float32 within the bounds of a coordinate."""
    numbers = data[first : first + size].copy().view(np.float32)
    fit = True
    for n in range(len(numbers)):
        fit &= abs(numbers[n]) <= np.float32(FARTHEST)
    return fit


@cached
def _doubles_fit(data: np.ndarray, first: int, size: int) -> bool:
    numbers = data[first : first + size].copy().view(np.float64)
    fit = True
    for n in range(len(numbers)):
        fit &= abs(numbers[n]) <= FARTHEST
    return fit


@cached
def _ascend(data: np.ndarray, first: int, size: int) -> bool:
    """Whether these bytes are uint64 that rise."""
    numbers = data[first : first + size].copy().view(np.uint64)
    rise = True
    for n in range(1, len(numbers)):
        rise &= numbers[n] > numbers[n - 1]
    return rise


@cached
def _read_one(
    data: np.ndarray, at: int, end: int, base: int, row: int, tick: int, layout: tuple, roll: tuple, diagram: int, out: tuple
) -> bool:
    spelled, spelled_ends, incarnations, limits = roll
    table, spans = out
    if end - at > MAX_BYTES:
        return False
    begin = spelled_ends[row - 1] if row > 0 else 0
    first, length, at = _text(data, _after(data, at, end, layout, HEAD), end)
    if at < 0 or not _same(data, first, length, spelled, begin, spelled_ends[row]):
        return False
    sender = first, first + length
    incarnation, at = _whole(data, _after(data, at, end, layout, INCARNATION), end)
    said_at, at = _whole(data, _after(data, at, end, layout, TICK), end)
    if at < 0 or incarnation != incarnations[row] or said_at != tick:
        return False
    x, at = _real(data, _after(data, at, end, layout, POSE), end, FARTHEST)
    y, at = _real(data, at, end, FARTHEST)
    heading, at = _real(data, at, end, FARTHEST)
    east, at = _real(data, _after(data, at, end, layout, COD), end, FARTHEST)
    north, at = _real(data, at, end, FARTHEST)
    radius, at = _real(data, _after(data, at, end, layout, POWER_RADIUS), end, FARTHEST)
    unused, at = _real(data, _after(data, at, end, layout, UNUSED), end, LARGEST_AREA)
    if at < 0 or radius < 0.0 or unused < 0.0:
        return False
    apart, (capability, reach) = math.sqrt((east - x) ** 2 + (north - y) ** 2), limits[row]
    if not (unused <= capability and math.pi * radius * radius <= capability and apart <= reach):
        return False
    scan, seen, at = _bytes(data, _after(data, at, end, layout, SEEN), end, 8, MAX_DETECTIONS)
    at = _after(data, at, end, layout, SCANNED)
    if at < 0 or at >= end or not 0xC2 <= data[at] <= 0xC3:
        return False
    scanned = data[at] == 0xC3
    stamp, at = _whole(data, _after(data, at + 1, end, layout, CLAIM_TICK), end)
    number, at = _names(data, _after(data, at, end, layout, NAMES), end, sender)
    claim, generators, at = _bytes(data, _after(data, at, end, layout, CLAIM), end, 24, MAX_NAMES)
    view, at = _whole(data, _after(data, at, end, layout, VIEW), end)
    weight, at = _real(data, _after(data, at, end, layout, MASS), end, FARTHEST)
    states, count, at = _bytes(data, _after(data, at, end, layout, STATES), end, 16, MAX_PARTICLES)
    ids, numbers, at = _bytes(data, _after(data, at, end, layout, IDS), end, 8, MAX_PARTICLES)
    if at != end or weight < 0.0 or generators != number or numbers != count or stamp >= max(tick, 1) or count > 0 >= number:
        return False
    if not (_singles_fit(data, scan, 8 * seen) and _doubles_fit(data, claim, 24 * number) and _singles_fit(data, states, 16 * count)):
        return False
    if not _ascend(data, ids, 8 * count):
        return False
    table[row, X], table[row, Y], table[row, COS] = x, y, heading
    if not scanned:
        table[row, KIND] = SILENT
    table[row, DETECTIONS], table[row, WEIGHT], table[row, PARTICLES] = seen, weight, count
    table[row, EAST], table[row, NORTH] = (x, y) if diagram == 0 else (east, north)
    table[row, RADIUS] = radius if diagram == 2 else 0.0
    spans[row, SCAN_AT], spans[row, SCAN_COUNT], spans[row, STATES_AT] = base + scan, seen, base + states
    spans[row, COUNT], spans[row, IDS_AT], spans[row, STAMP], spans[row, CUT] = count, base + ids, stamp, view
    return True


@cached
def read(
    data: np.ndarray, ends: np.ndarray, rows: np.ndarray, base: int, tick: int, layout: tuple, roll: tuple, diagram: int, out: tuple
) -> bool:
    """Read gossips of `tick` that lie end to end in `data`, each into its row of a table and of the spans (`out`); False: one of them is
    nothing for this reader, and the rows named mean nothing.

    `base`: where `data` begins in all that was read for the round. `layout`: tokens end to end, and their ends. `roll`, by row: names end
    to end, their ends, incarnations, and limits (m^2, m) on unused capacity and on the way from sensor to COD. `diagram`: 0 voronoi,
    1 voronoi-cod, 2 power. In the table the heading (rad) takes the place of its cosine.
    """
    start = 0
    for n in range(len(ends)):
        if not _read_one(data, start, ends[n], base, rows[n], tick, layout, roll, diagram, out):
            return False
        start = ends[n]
    return True


@cached
def lay_out(data: np.ndarray, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Detections (D, 2), states (N, 4) float32 and ids (N,), row after row, and whether all rows name one claim tick and one view."""
    seen, count, agreed = 0, 0, True
    for r in range(len(spans)):
        seen, count = seen + spans[r, SCAN_COUNT], count + spans[r, COUNT]
        agreed &= spans[r, STAMP] == spans[0, STAMP] and spans[r, CUT] == spans[0, CUT]
    dots, states, ids = np.empty(8 * seen, np.uint8), np.empty(16 * count, np.uint8), np.empty(8 * count, np.uint8)
    dot, state, one = 0, 0, 0
    for r in range(len(spans)):
        size = 8 * spans[r, SCAN_COUNT]
        dots[dot : dot + size] = data[spans[r, SCAN_AT] : spans[r, SCAN_AT] + size]
        dot += size
        size = 8 * spans[r, COUNT]
        states[state : state + 2 * size] = data[spans[r, STATES_AT] : spans[r, STATES_AT] + 2 * size]
        ids[one : one + size] = data[spans[r, IDS_AT] : spans[r, IDS_AT] + size]
        state, one = state + 2 * size, one + size
    detections = dots.view(np.float32).reshape(-1, 2).astype(np.float64)
    return detections, states.view(np.float32).reshape(-1, 4), ids.view(np.uint64), agreed
