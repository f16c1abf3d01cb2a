"""The fuzzer: the kept seeds pass, many seeds pass, cases repeat themselves, and mutants are caught."""

import tomllib
from collections.abc import Sequence
from pathlib import Path

import msgspec
import pytest

from deploy.faults.faults import Schedule
from deploy.scenario import FaultSettings
from deploy.verify import fuzz
from deploy.verify.fuzz import BLANK, CALM_END, HEAL_AT, KINDS, PROFILES, SETTLE, Case, Failure, draw, healing, play, settled_at, shrink
from deploy.verify.invariants import LOADS
from tests.swarm.mutants import MUTANTS, Mutant, births_by_the_owner_only, no_dedupe_by_id, no_overlap_rule

KEPT = [int(line.split()[0]) for line in (Path(__file__).parent / "seeds.txt").read_text().splitlines() if not line.startswith("#")]


def with_seeds(seeds: Sequence[int], fast: int, slow: int) -> pytest.MarkDecorator:
    """The test takes these seeds. The first few are fast, the next few slow, and the others nightly."""
    rare = [pytest.mark.slow, pytest.mark.nightly]
    marks = [rare[: (place >= fast) + (place >= fast + slow)] for place in range(len(seeds))]
    return pytest.mark.parametrize("seed", [pytest.param(seed, marks=mark) for seed, mark in zip(seeds, marks)])


@with_seeds(KEPT, fast=1, slow=len(KEPT))
def test_what_once_broke_holds(seed: int) -> None:
    assert play(draw(seed)) is None


@with_seeds(range(1, 13), fast=2, slow=4)
def test_the_first_dozen_seeds_hold(seed: int) -> None:
    assert play(draw(seed)) is None


@pytest.mark.parametrize("profile", PROFILES)
@with_seeds(range(1, 5), fast=1, slow=1)
def test_the_first_seeds_of_slow_and_bad_networks_hold(profile: str, seed: int) -> None:
    assert play(draw(seed, profile)) is None


@pytest.mark.slow
def test_a_late_swarm_is_one_filter_again_five_seconds_after_the_last_late_message() -> None:
    """All agents are frozen for 3.2 s, and from then on messages are 1.4 s late until all is healed."""
    blows = FaultSettings(at=11.32, verb="freeze", value=3.16), FaultSettings(at=12.26, verb="delay", who="100%", value=1.406)
    case = draw(4, "late")
    timing = msgspec.structs.replace(case.scenario.timing, look_ahead=2.5)
    scenario = msgspec.structs.replace(case.scenario, faults=(*blows, *healing()), timing=timing)
    assert play(case._replace(scenario=scenario)) is None


def test_the_profiles_of_slow_and_bad_networks_draw_all_of_their_kinds_with_the_look_ahead_and_without() -> None:
    for profile, kinds in PROFILES.items():
        cases = [draw(seed, profile) for seed in range(30)]
        assert {kind for case in cases for kind in case.kinds} == set(kinds) and all(kinds[0] in case.kinds for case in cases)
        assert {case.scenario.timing.look_ahead > 0.0 for case in cases} == {True, False}


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("profile", PROFILES)
def test_a_hundred_seeds_of_slow_and_bad_networks_hold(profile: str) -> None:
    assert [str(failure) for failure in fuzz.run(range(5, 101), profile=profile)] == []


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_three_hundred_seeds_hold() -> None:
    assert [str(failure) for failure in fuzz.run(range(13, 301))] == []


def test_a_seed_is_a_case_for_ever_and_all_kinds_of_faults_occur() -> None:
    cases = [draw(seed) for seed in range(60)]
    assert cases == [draw(seed) for seed in range(60)]
    assert {kind for case in cases for kind in case.kinds} == {*KINDS, *LOADS}
    assert {case.is_ledger for case in cases} == {True, False}
    assert any(len(case.kinds) == 1 for case in cases) and any(len(case.kinds) > 5 for case in cases)
    for case in cases:
        assert case.scenario.faults[-len(healing()) :] == healing()
        assert all(fault.at <= HEAL_AT for fault in case.scenario.faults)


def test_shrinking_keeps_the_faults_that_matter_and_the_healing() -> None:
    case = draw(1)
    extra = FaultSettings(at=3.0, verb="kill", who="1")
    case = case._replace(scenario=msgspec.structs.replace(case.scenario, faults=(extra, *case.scenario.faults)))
    smaller, what = shrink(case, "broken", lambda tried: "broken" if extra in tried.scenario.faults else None)
    assert [fault for fault in smaller.scenario.faults if fault != BLANK] == [extra, *healing()] and what == "broken"


def with_faults(*faults: FaultSettings) -> Case:
    case = draw(1)
    return case._replace(scenario=msgspec.structs.replace(case.scenario, faults=(*faults, *healing())))


def victims(case: Case, at: float) -> list[str]:
    """Whom the fault at a time strikes when nobody has died."""
    team = [*case.scenario.members]
    schedule = Schedule(case.scenario.run.seed, case.scenario.faults)
    schedule.due(at - 0.1, team, [], team)
    [action] = schedule.due(at, team, [], team)
    return action.names


def test_shrinking_leaves_the_victims_of_later_faults_as_they_are() -> None:
    first, later = FaultSettings(at=3.0, verb="kill", who="1"), FaultSettings(at=9.0, verb="pause", who="1")
    case = with_faults(first, later)
    assert victims(case, 9.0) != victims(with_faults(later), 9.0)  # deleted, the first one would change the case

    def play(tried: Case) -> str | None:
        return "broken" if later in tried.scenario.faults and victims(tried, 9.0) == victims(case, 9.0) else None

    assert shrink(case, "broken", play)[0].scenario.faults == (BLANK, later, *healing())


def test_shrinking_goes_on_until_no_single_fault_can_be_left_out() -> None:
    """The first can be left out only without the second."""
    one, two, three = (FaultSettings(at=at, verb="kill", who="1") for at in (3.0, 4.0, 5.0))

    def play(tried: Case) -> str | None:
        return "broken" if three in tried.scenario.faults and (one in tried.scenario.faults or two not in tried.scenario.faults) else None

    assert shrink(with_faults(one, two, three), "broken", play)[0].scenario.faults == (BLANK, BLANK, three, *healing())


@pytest.mark.parametrize("seed", range(1, 9))
def test_the_calm_end_is_as_many_ticks_whatever_the_length_of_a_tick(seed: int) -> None:
    scenario = draw(seed).scenario
    assert scenario.run.ticks - round(settled_at(scenario) / scenario.run.dt) == CALM_END
    assert settled_at(scenario) >= HEAL_AT + SETTLE


def test_a_failure_says_how_to_replay_it() -> None:
    fault = FaultSettings(at=3.0, verb="partition", who="10%", seconds=0.5, options={"kind": "one-way", "tokens": False})
    lines = str(Failure(7, "a hole", (BLANK, fault))).splitlines()
    assert lines == [
        "seed 7: a hole",
        "  replay: covey fuzz --seeds 1 --first 7",
        '  {at = 3.0, verb = "partition", who = "10%", seconds = 0.5, options = {kind = "one-way", tokens = false}}',
    ]
    assert msgspec.convert(tomllib.loads(f"fault = {lines[-1]}")["fault"], FaultSettings) == fault


def notices(mutant: Mutant, case: Case) -> bool:
    with pytest.MonkeyPatch.context() as patch:
        return mutant(case, patch) is not None


LATE = (births_by_the_owner_only, no_overlap_rule)  # noticed after many ticks, so nightly
RULES = [pytest.param(mutant, marks=pytest.mark.nightly if mutant in LATE else (), id=mutant.__name__) for mutant in MUTANTS]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("mutant", RULES)
def test_a_rule_left_out_is_noticed_within_a_hundred_seeds(mutant: Mutant) -> None:
    """The seeds that noticed it when this was written come first."""
    assert any(notices(mutant, draw(seed)) for seed in dict.fromkeys([*MUTANTS[mutant], *range(1, 101)]))


@pytest.mark.slow
def test_an_id_comes_twice_only_where_both_sides_of_a_border_count() -> None:
    case = draw(MUTANTS[no_dedupe_by_id][0])
    timing = case.scenario.timing
    one_side = msgspec.structs.replace(case.scenario, timing=msgspec.structs.replace(timing, overlap=0.0))
    assert timing.overlap > 0.0 and notices(no_dedupe_by_id, case)
    assert not notices(no_dedupe_by_id, case._replace(scenario=one_side))
