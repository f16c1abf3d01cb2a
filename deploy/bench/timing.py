"""How the benchmarks measure: CPU time of the process, several batches, their median; a table for people and JSON for programs."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

BenchRow = dict[str, Any]


def cpu_seconds(work: Callable[[], object]) -> float:
    """CPU time of this process over one call, s."""
    started = time.process_time()
    work()
    return time.process_time() - started


def median_seconds(work: Callable[[], object], batches: int = 7, ready: Callable[[], object] = lambda: None) -> float:
    """Median CPU time of a call over several batches, s; `ready` goes before each and is not counted. One call more warms up."""
    found = []
    for _ in range(batches + 1):
        ready()
        found.append(cpu_seconds(work))
    return statistics.median(found[1:])


def in_turns(kinds: Mapping[str, Callable[[], object]], turns: int) -> dict[str, list[float]]:
    """CPU times of some kinds of work, s, one after the other, so often; the speed of a machine changes within minutes."""
    found: dict[str, list[float]] = {name: [] for name in kinds}
    for _ in range(turns):
        for name, work in kinds.items():
            found[name].append(cpu_seconds(work))
    return found


def table(rows: Sequence[BenchRow]) -> str:
    """Rows as a text table, columns in the order in which they first occur."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    lines = [columns, *([_text(row.get(column, "")) for column in columns] for row in rows)]
    widths = [max(len(line[place]) for line in lines) for place in range(len(columns))]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip() for line in lines)


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
