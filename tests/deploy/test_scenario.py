"""Scenarios: the teams of Table II, compositions, options laid over files, and what is said when they are wrong."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.config import AgentConfig
from deploy.cli.scenario_checks import check_scenario, interest_remarks, scale_remarks, team_remarks
from deploy.scenario import FOLDER, TeamSettings, find, parse_set, resolve, targets_in_words, team_counts, toml_text
from protocol.settings import BadSetting, CommonSettings, convert
from tests.docs import blocks_of
from world.config import WorldConfig

SHIPPED = ["anisotropic", "convergence", "efficacy", "heterogeneity", "mrclam", "quick", "solent", "students03"]


def counts(composition: str, triple: str = "ACD") -> dict[str, int]:
    return team_counts(TeamSettings(composition=composition, triple=triple))


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        ("1", {"A": 4, "B": 12}),
        ("2", {"A": 3, "C": 12, "D": 9}),
        ("3", {"A": 4, "C": 16, "D": 12}),
        ("4", {"A": 5, "C": 20, "D": 15}),
        ("5", {"A": 6, "C": 24, "D": 18}),
        ("6", {"E": 20, "H": 4}),
        ("7", {"E": 20, "G": 10}),
        ("8", {"E": 20, "F": 20}),
    ],
)
def test_the_teams_of_table_ii(number: str, expected: dict[str, int]) -> None:
    assert counts(number) == expected


def test_teams_2_to_5_have_24_32_40_and_48_sensors_in_the_ratio_1_4_3() -> None:
    """Table II prints 8 for the third class of team 2, which makes 23; figure 4 says 24."""
    for number, size in zip("2345", (24, 32, 40, 48)):
        first, second, third = counts(number).values()
        assert (first + second + third, second, third) == (size, 4 * first, 3 * first)


def test_the_lost_column_of_table_ii_is_an_option() -> None:
    assert counts("3", "ABC") == {"A": 4, "B": 16, "C": 12}
    assert counts("2", "BCD") == {"B": 3, "C": 12, "D": 9}


@pytest.mark.parametrize("triple", ["", "AC", "AAC", "ACA"])
def test_a_triple_that_is_not_three_different_classes_is_refused(triple: str) -> None:
    with pytest.raises(BadSetting, match=f"team.triple = '{triple}': should be three different sensor classes"):
        counts("3", triple)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("20E+4H", {"E": 20, "H": 4}),
        ("A4,B12", {"A": 4, "B": 12}),
        ("A4 B12", {"A": 4, "B": 12}),
        ("4A, 12B", {"A": 4, "B": 12}),
        ("  2A ", {"A": 2}),
        ("1A+1B+2A", {"A": 3, "B": 1}),
        ("3wide+2narrow", {"wide": 3, "narrow": 2}),
        ("10000A", {"A": 10000}),
    ],
)
def test_a_composition_counts_its_classes_in_order(text: str, expected: dict[str, int]) -> None:
    assert counts(text) == expected
    assert list(counts(text)) == list(expected)


@given(st.dictionaries(st.sampled_from("ABCDEFGH"), st.integers(1, 50), min_size=1), st.sampled_from(["+", ",", " ", ", "]), st.booleans())
def test_any_composition_reads_back_in_both_spellings(team: dict[str, int], separator: str, number_first: bool) -> None:
    text = separator.join(f"{number}{name}" if number_first else f"{name}{number}" for name, number in team.items())
    assert counts(text) == team


@pytest.mark.parametrize("text", ["", "9", "0", "A", "20", "20E-4H", "20E+", "4 A", "A4;B12", "-4A", "1.5A"])
def test_a_composition_that_cannot_be_read_shows_how_one_looks(text: str) -> None:
    with pytest.raises(BadSetting, match=r"team\.composition = .*: should be a team 1-8, or such as 20E\+4H or A4,B12"):
        counts(text)


@pytest.mark.parametrize("text", ["0A", "10001A", "5001A+5000B"])
def test_a_team_of_no_sensors_or_of_too_many_is_refused(text: str) -> None:
    with pytest.raises(BadSetting, match=r"team\.composition = .*: a team has 1 to 10000 sensors"):
        counts(text)


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_scenario_resolves_and_its_team_is_spelled_out(name: str) -> None:
    scenario = resolve(name)
    assert Counter(scenario.members.values()) == counts(scenario.team.composition, scenario.team.triple)
    assert list(scenario.members) == [f"s{number}" for number in range(1, len(scenario.members) + 1)]
    assert scenario.run.scenario == name


LAB = next(block.text for block in blocks_of("docs/how-to/fit.md") if block.language == "toml")


def test_a_bin_or_a_speed_that_is_too_large_for_what_the_sensors_see_is_remarked_on(tmp_path: Path) -> None:
    """With 5 bins within the reach of 2 m, and 10 ticks to cross it, there is no remark."""
    (lab := tmp_path / "lab.toml").write_text(LAB)

    def remarks(**settings: Any) -> list[str]:
        return scale_remarks(resolve(str(lab), {name.replace("__", "."): value for name, value in settings.items()}))

    assert (
        remarks() == remarks(extraction__bin=0.4) == remarks(filter__speed=0.8) == remarks(extraction__bin=1.0, detection__noise=0.4) == []
    )
    wide, fast = remarks(extraction__bin=1.0, filter__speed=2.0)
    assert wide.startswith("extraction.bin = 1: a target is read off 5 x 5 bins, and cam reaches 2 m; should be 0.1 to 0.15 m,")
    assert fast.startswith("filter.speed = 2: crosses the reach of cam, 2 m, in 4.0 ticks; should be the usual speed of your targets,")
    assert remarks(extraction__bin=0.41) and remarks(filter__speed=0.81)
    mixture: dict[str, Any] = {"filter__kind": "gaussian-mixture", "detection__noise": 0.5}
    assert remarks(**mixture, mixture__spread=0.5) == remarks(detection__noise=0.5, mixture__spread=0.4) == []
    [narrow] = remarks(**mixture, mixture__spread=0.4)
    assert narrow.startswith("mixture.spread = 0.4: what is born") and narrow.endswith("should be at least detection.noise, 0.5 m")
    assert [name for name in SHIPPED if scale_remarks(resolve(name))] == []


def test_neighbours_alone_with_sensors_much_larger_than_those_of_the_paper_are_remarked_on() -> None:
    def remarks(angle: float, radius: float, **settings: str) -> list[str]:
        own = {"team.composition": "2X+2D", "sensors.X.angle": angle, "sensors.X.radius": radius}
        return interest_remarks(resolve("quick", {"timing.interest": "neighbours", **own, **settings}))

    assert remarks(360.0, 1000.0) == remarks(240.0, 25.0) == remarks(45.0, 2000.0, **{"timing.interest": "all"}) == []
    wide, far = remarks(45.0, 2000.0)
    assert "margin of 14 m, and a COD may jump by 2599 m: some may be missed; should be 'all'" in wide
    assert "points 6 m apart, and a sensor reaches 2000 m: the choice takes long; should be 'all'" in far
    assert len(remarks(45.0, 25.0)) == len(remarks(360.0, 1001.0)) == 1


def test_a_sensor_that_sees_too_many_gaussians_at_once_is_refused_with_a_spread_that_is_possible() -> None:
    """2.25 km^2 hold 31888 places 8.4 m apart; a particle filter has none, nor has a mixture without a prior."""
    far = {"arena.width": 1500.0, "arena.height": 1500.0, "sensors.X.angle": 360.0, "sensors.X.radius": 9000.0, "team.composition": "2X"}
    far |= {"filter.kind": "gaussian-mixture", "filter.prior_density": 1e-6}
    with pytest.raises(BadSetting, match=r"^mixture\.spread = 6: a sensor sees 31888 Gaussians .* at once; should be at least 18 m$"):
        check_scenario(resolve("quick", far))
    for possible in ({"mixture.spread": 18.0}, {"filter.prior_density": 0.0}, {"sensors.X.radius": 300.0}, {"filter.kind": "particles"}):
        check_scenario(resolve("quick", far | possible))


class Crowd:
    """A motion that follows the target farthest north."""

    def __init__(self, *_: Any) -> None: ...

    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> Any:
        """A tenth of the way to it."""
        return positions + 0.1 * (positions[positions[:, 1].argmax()] - positions), headings


def test_a_motion_that_cannot_move_no_targets_is_refused_before_the_run() -> None:
    """It would end a run as late as its last target leaves."""
    with pytest.raises(BadSetting, match=r"Crowd\.move of 0 targets raised ValueError"):
        check_scenario(resolve("quick", {"targets.motion": f"{__name__}:Crowd"}))


def test_classes_that_a_team_does_not_read_are_remarked_on() -> None:
    assert team_remarks(resolve("quick", {"team.composition": "2A", "team.triple": "ABC"})) == [
        "team.triple = 'ABC': should be left out with team 2A: teams 2, 3, 4, 5 alone have it"
    ]
    assert team_remarks(resolve("quick", {"team.composition": "2", "team.triple": "ABC"})) == []
    assert [name for name in SHIPPED if team_remarks(resolve(name))] == []


@pytest.mark.parametrize(
    ("count", "border", "said"), [(0, "cross", ""), (2, "reflect", ""), (2, "cross", " at the start, and others enter and leave")]
)
def test_others_enter_where_some_are_there_and_the_border_is_crossed(count: int, border: str, said: str) -> None:
    """The rate of arrivals follows from the number at the start."""
    assert targets_in_words(resolve("quick", {"targets.count": count, "targets.border": border})) == f"{count} targets{said}"


def test_the_shipped_scenarios_are_these() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.toml")) == SHIPPED


def test_the_scenarios_of_the_paper_have_the_numbers_of_section_iv() -> None:
    first, second = resolve("convergence"), resolve("efficacy")
    assert (first.arena.width, first.arena.height, first.run.seconds, first.targets.count) == (40.0, 40.0, 200.0, 8)
    assert (first.targets.border, first.targets.heading_noise, len(first.members)) == ("reflect", 0.0, 16)
    assert (second.arena.width, second.arena.height, second.run.seconds, second.targets.border) == (100.0, 100.0, 1000.0, "cross")
    assert (first.limits.speed, first.limits.turn_rate, first.targets.speed) == (2.0, 5.0, 2.0)


def test_agents_and_world_read_the_same_file_each_its_own_sections() -> None:
    data = {"run": {"dt": 0.5}, "targets": {"count": 3}, "filter": {"gate": 5.0}, "team": {"composition": "2"}}
    assert convert(data, AgentConfig, "x").filter.gate == 5.0
    assert convert(data, WorldConfig, "x").targets.count == 3
    assert convert(data, CommonSettings, "x").run.dt == 0.5


def test_options_are_laid_over_the_file() -> None:
    scenario = resolve("convergence", {"run.seed": 9, "team.composition": "2A+1B", "capacity.mode": "static", "birth.background": False})
    assert (scenario.run.seed, scenario.capacity.mode, scenario.birth.background) == (9, "static", False)
    assert scenario.members == {"s1": "A", "s2": "A", "s3": "B"}
    assert scenario.arena.width == 40.0


MEMBERS = '[members]\nlefty = "C"\nrighty = "wide"\n[sensors.wide]\nangle = 180.0\nradius = 4.0\n'


def test_a_scenario_that_spells_out_its_members_is_not_asked_for_a_team(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f"[team]\n{MEMBERS}", encoding="utf-8")  # an empty section, as `covey init` writes it
    scenario = resolve(str(path))
    assert scenario.members == {"lefty": "C", "righty": "wide"}
    assert scenario.run.scenario == str(path)


def test_a_team_beside_members_is_refused_in_the_file_and_as_an_option(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'[team]\ncomposition = "5"\n{MEMBERS}', encoding="utf-8")
    with pytest.raises(BadSetting) as caught:
        resolve(str(path))
    assert str(caught.value) == f"{path}: team.composition = '5': should be left out, or empty, for [members] names other agents"
    path.write_text(MEMBERS, encoding="utf-8")
    with pytest.raises(BadSetting, match=r"mine.toml with options: team.composition = '3': should be left out"):
        resolve(str(path), {"team.composition": "3"})
    with pytest.raises(BadSetting, match=r"team.triple = 'ABC': should be left out"):
        resolve(str(path), {"team.triple": "ABC"})


@pytest.mark.parametrize("members", ["", MEMBERS])
def test_the_run_toml_of_a_scenario_is_a_scenario_with_the_same_members(tmp_path: Path, members: str) -> None:
    path, again = tmp_path / "mine.toml", tmp_path / "run.toml"
    path.write_text(f"[run]\nseed = 4\n{members}", encoding="utf-8")
    scenario = resolve(str(path))
    again.write_text(toml_text(scenario), encoding="utf-8")
    assert resolve(str(again)) == scenario


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        ({"run.sead": 1}, "run.sead: there is no such field; did you mean seed?"),
        ({"tagrets.count": 1}, "tagrets: there is no such field; did you mean targets?"),
        ({"targets.count": -1}, "targets.count = -1: should be a whole number >= 0"),
        ({"partition.kind": "vornoi"}, "partition.kind = 'vornoi': should be one of power, voronoi, voronoi-cod"),
        ({"capacity.mode": "full"}, "capacity.mode = 'full': should be one of literal, expected, static, saturating"),
        ({"filter.most_particles": 9000}, "filter.most_particles = 9000: should be a whole number <= 8000"),
        ({"timing.deadline": 1.5}, "timing.deadline = 1.5: should be a number <= 1.0"),
        ({"bodies.poses": {"s1": [1.0, 2.0]}}, "bodies.poses.s1 = [1.0, 2.0]: should be a list of length 3, got 2"),
        ({"team.composition": "3Z"}, "team.composition: sensor class 'Z' does not exist; known are A, B, C, D, E, F, G, H"),
        (
            {"team.composition": "3", "team.triple": "acd"},
            "team.triple: sensor class 'a' does not exist; known are A, B, C, D, E, F, G, H",
        ),
        (
            {"filter.compact": True, "timing.overlap": 3.0},
            "filter.compact = true: each owner numbers particles anew, so timing.overlap should be 0",
        ),
        (
            {"control.mode": "search-and-track", "arena.width": 2010.0, "arena.height": 2000.0},
            "search.bin = 2: the arena has 1005000 bins, and search-and-track looks at at most 1000000; should be at least 2.1 m; "
            "about a fifth of what sensors reach is usual",
        ),
        ({"control.mode": "search-and-track", "run.dt": 2.5}, "search.horizon = 2: should be run.dt (2.5 s) or more"),
        ({"sensors.X.angle": 90.0, "team.composition": "3X"}, "sensors.X: a wedge needs an angle (degrees) and a radius (m)"),
    ],
    ids=str,
)
def test_a_wrong_option_is_told_in_one_line_with_the_file(overrides: dict[str, Any], complaint: str) -> None:
    with pytest.raises(BadSetting) as caught:
        resolve("quick", overrides)
    assert str(caught.value) == f"{FOLDER / 'quick.toml'} with options: {complaint}"


def test_an_option_inside_something_that_is_no_section_is_refused() -> None:
    with pytest.raises(BadSetting, match=r"run\.seed\.x: seed is not a section"):
        resolve("quick", {"run.seed": 1, "run.seed.x": 2})


def test_a_wrong_file_is_told_with_its_path_and_without_options(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[[faults]]\nat = 5.0\nverb = 'kill'\nwhom = '30%'\n", encoding="utf-8")
    with pytest.raises(BadSetting) as caught:
        resolve(str(path))
    assert str(caught.value) == f"{path}: faults[0].whom: there is no such field; did you mean who?"


def test_an_unknown_scenario_lists_the_known_ones() -> None:
    known = "anisotropic, convergence, efficacy, heterogeneity, mrclam, quick, solent, students03"
    with pytest.raises(BadSetting, match=f"scenario 'quik' does not exist; known are {known}, or"):
        find("quik")


def test_a_path_is_taken_as_a_path() -> None:
    assert find("here/it.is") == Path("here/it.is")
    assert find("mine.toml") == Path("mine.toml")
    assert find("quick") == FOLDER / "quick.toml"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("run.seed=3", ("run.seed", 3)),
        ("run.dt = 0.5", ("run.dt", 0.5)),
        ("birth.background=false", ("birth.background", False)),
        ("capacity.mode=static", ("capacity.mode", "static")),
        ('run.name="a b"', ("run.name", "a b")),
        ("team.composition=20E+4H", ("team.composition", "20E+4H")),
        ('network.seeds=["tcp/127.0.0.1:7447"]', ("network.seeds", ["tcp/127.0.0.1:7447"])),
        ("run.scenario=a=b", ("run.scenario", "a=b")),
        ("run.scenario=", ("run.scenario", "")),
    ],
)
def test_set_reads_a_toml_value_and_bare_words_as_text(text: str, expected: tuple[str, Any]) -> None:
    assert parse_set(text) == expected


@pytest.mark.parametrize("text", ["", "run.seed", "seed=3", "=3"])
def test_set_without_a_section_a_key_or_a_value_is_refused(text: str) -> None:
    with pytest.raises(BadSetting, match=r"should read section\.key=value"):
        parse_set(text)


@pytest.mark.parametrize("law", ["lloyd", "search-and-track"])
@pytest.mark.parametrize("name", ["convergence", "solent"])
def test_what_followed_from_others_in_a_resolved_scenario_follows_anew_and_what_was_said_stays(name: str, law: str, tmp_path: Path) -> None:
    told = {"control.mode": law, "run.clock": "lockstep" if law == "lloyd" else "realtime"}
    first = tmp_path / "first.toml"
    for other in ("lloyd", "search-and-track"):
        first.write_text(toml_text(resolve(name, {"control.mode": other, "run.clock": "realtime"})), encoding="utf-8")
        again, fresh = resolve(str(first), told), resolve(name, told)
        assert (again.extraction, again.network, again.run) == (fresh.extraction, fresh.network, fresh.run)
    first.write_text(toml_text(again).replace(f"bin = {again.extraction.bin}", "bin = 0.9"), encoding="utf-8")
    changed = resolve(str(first), {"control.mode": "lloyd"})
    assert changed.extraction.bin == 0.9 and "extraction.bin" not in changed.run.derived


@pytest.mark.parametrize("derived", ["7", '"extraction.bin"', "[3, {}]", '["team.composition", "extraction.bin.more"]'])
def test_a_list_of_what_was_derived_that_is_none_changes_nothing_or_is_told(derived: str, tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(f"[run]\nderived = {derived}\n[extraction]\nbin = 1.0\n", encoding="utf-8")
    if derived.startswith('["'):
        assert resolve(str(path), {"control.mode": "search-and-track"}).extraction.bin == 1.0
    else:
        with pytest.raises(BadSetting, match=r"run\.derived"):
            resolve(str(path))


def test_in_lockstep_more_messages_a_second_are_no_flood_unless_the_scenario_says_how_many() -> None:
    assert resolve("efficacy").network.most_per_second == 1000
    assert resolve("efficacy", {"run.clock": "lockstep"}).network.most_per_second == 5000
    assert resolve("efficacy", {"run.clock": "lockstep", "network.most_per_second": 70}).network.most_per_second == 70
    with pytest.raises(BadSetting, match=r"network\.most_per_second = 0: should be a whole number >= 1"):
        resolve("efficacy", {"network.most_per_second": 0})
