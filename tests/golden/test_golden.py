"""The golden record: today's runs are those of the record, hash by hash; and what the record itself promises."""

import copy
import os
import subprocess
import sys

import pytest

from agents.backend import PLAIN
from tests.golden.cases import CASES, INTERESTS, OSPA_SEEDS, PARTITIONS, TICKS, Case, case_of
from tests.golden.fields import FIELDS
from tests.golden.make import ROOT, check, steady_ospa
from tests.golden.record import Said, difference, play, record_of
from tests.golden.stored import FOLDER, read, read_ospa

QUICK = [  # some seconds
    "20E10G-all/deaths/1",
    "anisotropic-neighbours/lockstep/1",
]
SHORT = case_of("20E10G-all/deaths/1")
SLOW = [  # with QUICK and TAPPED, what continuous integration plays: every trouble with either interest, and every swarm with either
    "20E10G-neighbours/realtime/1",
    "anisotropic-all/loss/1",
    "anisotropic-all/realtime/1",
    "efficacy-all/lockstep/1",
    "efficacy-neighbours/deaths/1",
]
NIGHTLY = pytest.mark.nightly
TAPPED = "anisotropic-neighbours/loss/1"
RUNS = [(partition, seed) for partition in PARTITIONS for seed in OSPA_SEEDS]
OTHERS = [pytest.param(case, id=str(case), marks=() if str(case) in SLOW else NIGHTLY) for case in CASES if str(case) not in QUICK]
KINDS = [pytest.param(case, id=str(case), marks=() if str(case) == TAPPED else NIGHTLY) for case in CASES if case.seed == 1]


@pytest.mark.parametrize("case", [case_of(name) for name in QUICK], ids=str)
def test_some_runs_are_those_of_the_golden_record(case: Case) -> None:
    assert not (message := check(case)), message


@pytest.mark.slow
@pytest.mark.parametrize("case", OTHERS)
def test_all_runs_are_those_of_the_golden_record(case: Case) -> None:
    assert not (message := check(case)), message


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("partition, seed", RUNS)
def test_steady_ospa_is_that_of_the_golden_record(partition: str, seed: int) -> None:
    assert steady_ospa((partition, seed)) == read_ospa()[partition, seed]


@pytest.mark.slow
@pytest.mark.parametrize("interest", [INTERESTS[0], *(pytest.param(interest, marks=NIGHTLY) for interest in INTERESTS[1:])])
def test_a_bus_that_delivers_one_by_one_gives_the_same_record(interest: str) -> None:
    case = SHORT._replace(interest=interest)
    assert difference(read(case), play(case, batches=False)) == ""


@pytest.mark.slow
@pytest.mark.parametrize("case", KINDS)
def test_every_kind_of_case_gives_the_same_record_when_watched_and_one_by_one(case: Case) -> None:
    assert difference(read(case), play(case, tapped=True)) == ""
    assert difference(read(case), play(case, tapped=True, batches=False)) == ""


@pytest.mark.slow
@pytest.mark.nightly
def test_plain_arithmetic_gives_the_same_record() -> None:
    assert difference(read(SHORT), play(SHORT, backend=PLAIN)) == ""


@pytest.mark.slow
@pytest.mark.nightly
def test_the_order_of_hashes_does_not_matter() -> None:
    environment = {**os.environ, "PYTHONHASHSEED": "4711", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "tests.golden.make", "--check", str(SHORT)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def said() -> list[Said]:
    """What is said in the short case."""
    return play(SHORT)


def test_a_difference_names_the_tick_the_agent_and_the_field(said: list[Said]) -> None:
    kept = record_of(said)
    assert difference(kept, said) == ""
    changed = copy.deepcopy(said)
    changed[7]["s3"]["command"][0][2] += 1e-12  # the turn rate
    changed[9]["s5"]["mass"][0][1] *= 1.0 + 1e-15
    assert difference(kept, changed) == "tick 7, agent s3, field command"
    assert difference(kept._replace(fields=[], agents=[]), changed) == "tick 7"


def test_every_field_is_in_the_record(said: list[Said]) -> None:
    found = {field for tick in said for fields in tick.values() for field in fields}
    assert found == set(FIELDS)
    kept = read(SHORT)
    assert len(kept.ticks) == len(kept.fields) == len(kept.agents) == TICKS
    assert {len(row) for row in kept.fields} == {len(FIELDS)} and {len(row) for row in kept.agents} == {30}
    assert any("." in row for row in kept.agents), "nobody was ever silent: did the faults strike?"


def test_no_kind_of_case_is_left_to_the_night() -> None:
    played = [case_of(name) for name in (*QUICK, *SLOW, TAPPED)]
    assert {(case.interest, case.trouble) for case in played} == {(case.interest, case.trouble) for case in CASES}
    assert {(case.swarm, case.interest) for case in played} == {(case.swarm, case.interest) for case in CASES}


def test_the_record_is_small() -> None:
    assert sum(file.stat().st_size for file in FOLDER.iterdir() if file.is_file()) < 300_000
