"""The command of the golden record.

python -m tests.golden.make                     write all records anew
python -m tests.golden.make --check [WORD ...]  compare, and say where each case differs first; words: parts of the cases' names
python -m tests.golden.make --case NAME         the hash of each agent in each tick of a case
python -m tests.golden.make --against REV NAME  play a case here and at a revision, and show the first values that differ
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from deploy.simulation import Simulation
from tests.golden.cases import CASES, OSPA_SEEDS, PARTITIONS, TICKS, Case, case_of, ospa_scenario
from tests.golden.fields import FIELDS, digest
from tests.golden.record import Record, Said, difference, names_in, play, record_of
from tests.golden.stored import OSPA, read, write, write_ospa

ROOT = Path(__file__).resolve().parents[2]
MOVED = """{case}: differs from the golden record first in {where}.
  values: python -m tests.golden.make --against HEAD {case}
  If the change is meant: python -m tests.golden.make, and say why in the commit and in CHANGELOG.md."""


def check(case: Case) -> str:
    """Where a case differs from its record, as a message; empty: nowhere."""
    where = difference(read(case), play(case))
    return MOVED.format(case=case, where=where) if where else ""


def steady_ospa(run: tuple[str, int]) -> float:
    """Of a partition method and a seed, m."""
    return round(Simulation(ospa_scenario(*run)).run().steady_ospa, 9)


def make() -> None:
    """Write all records."""
    records: dict[Case, Record] = {}
    with ProcessPoolExecutor() as pool:
        for number, (case, record) in enumerate(zip(CASES, pool.map(_record, CASES)), start=1):
            records[case] = record
            _say(f"{number}/{len(CASES)} {case}")
        write(records)
        runs = [(partition, seed) for partition in PARTITIONS for seed in OSPA_SEEDS]
        write_ospa(dict(zip(runs, pool.map(steady_ospa, runs))))
        _say(f"{len(runs)} runs in {OSPA.name}")


def check_all(words: Sequence[str]) -> int:
    """Compare the cases whose names hold one of the words, or all; how many differ."""
    cases = [case for case in CASES if not words or any(word in str(case) for word in words)]
    with ProcessPoolExecutor() as pool:
        found = [message for message in pool.map(check, cases) if message]
    print(*found, f"{len(found)} of {len(cases)} cases differ", sep="\n")
    return len(found)


def show(case: Case) -> None:
    """The hash of each agent in each tick."""
    said = play(case)
    names = names_in(said)
    print("tick", *(f"{name:8}" for name in names))
    for tick, found in enumerate(said):
        print(f"{tick:4}", *(digest(list(found[name].values())).hex()[:8] if name in found else " " * 8 for name in names))


def against(revision: str, case: Case) -> int:
    """Play a case here and at a revision; print the first agent, field and values that differ."""
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(["git", "archive", revision], cwd=ROOT, stdout=subprocess.PIPE, check=True)
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        command = [sys.executable, "-m", "tests.golden.make", "--values", str(case)]
        before = json.loads(subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, check=True).stdout)
    for line in _differences(before, json.loads(_as_json(play(case)))):
        print(line)
        return 1
    print(f"{case}: nothing differs from {revision}")
    return 0


def _differences(before: list[Said], now: list[Said]) -> Iterator[str]:
    for tick in range(TICKS):
        for name in {**before[tick], **now[tick]}:
            for field in FIELDS:
                old, new = (said[tick].get(name, {}).get(field) for said in (before, now))
                if old != new:
                    yield f"tick {tick}, agent {name}, field {field}:\n  before {old}\n  now    {new}"


def _record(case: Case) -> Record:
    return record_of(play(case))


def _as_json(said: list[Said]) -> str:
    return json.dumps(said, default=lambda array: array.tolist())


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden.make", description="The golden record: make it, or compare with it.")
    parser.add_argument("--check", nargs="*", metavar="WORD", help="compare the cases whose names hold one of the words, or all")
    parser.add_argument("--case", type=case_of, metavar="NAME", help="the hash of each agent in each tick of a case")
    parser.add_argument("--against", nargs=2, metavar=("REV", "NAME"), help="the first values that differ from those at a revision")
    parser.add_argument("--values", type=case_of, metavar="NAME", help="all values of a case as JSON")
    options = parser.parse_args()
    if options.check is not None:
        return min(1, check_all(options.check))
    if options.against:
        return against(options.against[0], case_of(options.against[1]))
    if options.values:
        print(_as_json(play(options.values)))
    elif options.case:
        show(options.case)
    else:
        make()
    return 0


if __name__ == "__main__":
    sys.exit(main())
