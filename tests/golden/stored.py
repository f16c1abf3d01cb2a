"""The files of the golden record: TOML, one line per case and tick hash after tick hash, and for one seed letters by field and agent."""

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from tests.golden.cases import DETAILED, SEEDS, TROUBLES, Case
from tests.golden.fields import FIELDS
from tests.golden.record import Record

FOLDER = Path(__file__).parent
OSPA = FOLDER / "ospa.toml"
HEAD = f"""# Written by python -m tests.golden.make; what is hashed: tests/golden/fields.py.
# A case: one hash per tick over all agents. The detail of seed {DETAILED}: per tick one letter for each of the fields
# ({", ".join(FIELDS)}) and one for each agent, s1 first.
"""


def read(case: Case) -> Record:
    """The record of a case."""
    data = _load(FOLDER / f"{case.group}.toml")[case.trouble]
    detail = data["detail"] if case.seed == DETAILED else {"fields": [], "agents": []}
    return Record(data[str(case.seed)].split(), detail["fields"], detail["agents"])


def write(records: Mapping[Case, Record]) -> None:
    """All records into their files."""
    for group in dict.fromkeys(case.group for case in records):
        found = {(case.trouble, case.seed): record for case, record in records.items() if case.group == group}
        parts = [HEAD, *(_section(trouble, {seed: found[trouble, seed] for seed in SEEDS}) for trouble in TROUBLES)]
        (FOLDER / f"{group}.toml").write_text("\n".join(parts))


def read_ospa() -> dict[tuple[str, int], float]:
    """Steady OSPA in m by partition method and seed."""
    return {(partition, int(seed)): value for partition, row in _load(OSPA).items() for seed, value in row.items()}


def write_ospa(values: Mapping[tuple[str, int], float]) -> None:
    """Steady OSPA of every method and seed into its file."""
    lines = ["# Written by python -m tests.golden.make: steady OSPA in m by partition method and seed (ospa_scenario in cases.py)."]
    for partition in dict.fromkeys(partition for partition, _ in values):
        row = ", ".join(f"{seed} = {value!r}" for (kind, seed), value in values.items() if kind == partition)
        lines.append(f"{partition} = {{ {row} }}")
    OSPA.write_text("\n".join(lines) + "\n")


def _section(trouble: str, records: Mapping[int, Record]) -> str:
    lines = [f"[{trouble}]", *(f'{seed} = "{" ".join(record.ticks)}"' for seed, record in records.items())]
    lines += [f"[{trouble}.detail]"]
    lines += [f"{name} = {_rows(rows)}" for name, rows in zip(("fields", "agents"), records[DETAILED][1:])]
    return "\n".join(lines) + "\n"


def _rows(rows: list[str]) -> str:
    return "[\n" + "".join(f'    "{row}",\n' for row in rows) + "]"


@cache
def _load(path: Path) -> Any:
    return tomllib.loads(path.read_text())
