"""Recorded worlds: what the loaders read, what they leave out, and what they refuse, by file and line."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from deploy.scenario import resolve, world_config
from protocol.settings import ArenaSettings, BadSetting
from world.config import RecordedSettings
from world.recorded.lines import Line
from world.recorded.local_frame import LocalFrame
from world.recorded.pedestrians import read_pedestrians
from world.recorded.ships import read_ships
from world.recorded.targets import RecordedTargets
from world.recorded.tracks import RecordedWorld, Report, without_leaps
from world.sources import READERS, recording_of, sources_of

HEAD = "Time,MMSI,Latitude_degrees,Longitude_degrees,COG_degrees,SOG_knots"
PEOPLE = RecordedSettings(kind="pedestrians", data="x")
SHIPS = RecordedSettings(kind="ships", data="x", origin=(50.0, -1.0), longest_gap=60.0, longest_hole=60.0)
ARENA = ArenaSettings(width=10.0, height=10.0)


def people(tmp_path: Path, *lines: str) -> Path:
    """A file of pedestrians: frame, person, x and y of each."""
    rows = [line.split() for line in lines]
    file = tmp_path / "people.txt"
    file.write_text("# a comment\n" + "\n".join(f"{frame} {who} {x} 0 {y} 0 0 0" for frame, who, x, y in rows) + "\n")
    return file


def ships(tmp_path: Path, *lines: str, head: str = HEAD) -> Path:
    """A file of AIS reports: seconds after 13:00:00, MMSI, latitude and longitude of each."""
    rows = [line.split() for line in lines]
    file = tmp_path / "ships.csv"
    texts = [f"2016-01-12 13:{int(at) // 60:02}:{float(at) % 60.0:06.3f},{who},{lat},{lon},0,0" for at, who, lat, lon in rows]
    file.write_text("\n".join([head, *texts]) + "\n")
    return file


def test_a_person_appears_with_the_first_line_and_leaves_with_the_last_and_walks_straight_in_between(tmp_path: Path) -> None:
    file = people(tmp_path, "0 7 1 1", "10 7 2 1", "10 9 5 5", "20 7 2 2", "20 9 5 6", "30 9 5 7")
    targets = RecordedTargets(read_pedestrians(file, PEOPLE).visits, ARENA, dt=0.2, start=0.0)
    seen = []
    for _ in range(7):
        seen.append({int(name): tuple(np.round(place, 9)) for name, place in zip(targets.ids, targets.positions)})
        targets.step()
    assert seen[0] == {7: (1.0, 1.0)}
    assert seen[1] == {7: (1.5, 1.0)}
    assert seen[3] == {7: (2.0, 1.5), 9: (5.0, 5.5)}
    assert seen[5] == {9: (5.0, 6.5)}


def test_a_target_outside_the_arena_is_away(tmp_path: Path) -> None:
    file = people(tmp_path, "0 1 -1 5", "10 1 1 5", "20 1 3 5")
    targets = RecordedTargets(read_pedestrians(file, PEOPLE).visits, ARENA, dt=0.4, start=0.0)
    assert len(targets.ids) == 0
    targets.step()
    assert targets.positions.tolist() == [[1.0, 5.0]]


def test_a_target_that_is_silent_for_long_is_away_in_between_and_named(tmp_path: Path) -> None:
    file = people(tmp_path, *[f"{frame} 1 5 5" for frame in range(0, 400, 10)], "400 2 1 1", "410 1 5 5")
    lines = file.read_text().splitlines()
    lines = lines[:1] + sorted([*lines[1:], "0 3 1 0 1 0 0 0", "300 3 2 0 1 0 0 0"], key=lambda line: float(line.split()[0]))
    file.write_text("\n".join(lines))
    found = read_pedestrians(file, PEOPLE)
    assert len([visit for visit in found.visits if visit.target == 3]) == 2
    number = lines.index("300 3 2 0 1 0 0 0") + 1
    assert found.remarks == (f"{file}, line {number}: person 3 was silent for 12.0 s; it is away in between",)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["0 1 1 1", "200 1 1 1"], "line 3: a hole of 8 s in which there is no line; should be at most recorded.longest_hole = 5 s"),
        (["10 1 1 1", "0 1 1 1"], "line 3: the time falls by 0.4 s; lines should be in the order of time"),
        (["0 1 x 1"], "line 2: x = 'x': should be a finite number"),
        (["0 1 nan 1"], "line 2: x = 'nan': should be a finite number"),
        (["0.5 1 1 1"], "line 2: frame = '0.5': should be a whole number from 0 to 9007199254740991"),
        (["0 9007199254740992 1 1"], "line 2: person = '9007199254740992': should be a whole number from 0 to 9007199254740991"),
        (["0 1 1 1", "0 1 2 1"], "line 3: person = 1 stands in frame 0 twice"),
        (["0 1 1 1 "], "line 2: 9 columns; should be 8: frame, person, x, z, y, vx, vz, vy between blanks"),
    ],
)
def test_a_file_of_people_that_breaks_its_form_is_refused_by_file_and_line(tmp_path: Path, lines: list[str], said: str) -> None:
    file = people(tmp_path, *lines)
    if "9 columns" in said:
        file.write_text(file.read_text().replace("0 0 0", "0 0 0 0"))
    with pytest.raises(BadSetting) as error:
        read_pedestrians(file, PEOPLE)
    assert str(error.value) == f"{file}, {said}"


def test_a_person_who_would_fly_is_left_out_and_named(tmp_path: Path) -> None:
    file = people(tmp_path, "0 1 1 1", "10 1 9 1", "20 1 1.5 1")
    found = read_pedestrians(file, PEOPLE)
    assert found.remarks == (f"{file}, line 3: person 1 at 20 m/s: should be at most 12 m/s; the line is left out",)
    assert found.visits[0].places.tolist() == [[1.0, 1.0], [1.5, 1.0]]


@pytest.mark.parametrize(
    ("places", "wrong"),
    [
        ((25, 5, 5, 5), [1]),  # the first one
        ((25, 45, 5, 5, 5), [1, 2]),  # the first two, which contradict each other as well
        ((5, 25, 5, 5), [2]),
        ((5, 5, 25, 25, 5, 5), [3, 4]),  # two that agree, after two that do
        ((5, 25), [2]),  # without a third the earlier one is kept
        ((5,), []),
    ],
)
def test_of_two_reports_that_contradict_each_other_the_third_decides(tmp_path: Path, places: tuple[int, ...], wrong: list[int]) -> None:
    """Person 1 stands at 5 m and is reported five times a second; the file names comments first, so its reports begin in line 2."""
    file = people(tmp_path, *(f"{5 * number} 1 {x} 5" for number, x in enumerate(places)))
    found = read_pedestrians(file, PEOPLE)
    assert [remark.partition(":")[0] for remark in found.remarks] == [f"{file}, line {number + 1}" for number in wrong]
    [visit] = found.visits
    kept = [number for number in range(1, len(places) + 1) if number not in wrong]
    assert visit.times.tolist() == pytest.approx([0.2 * (number - 1) for number in kept])
    assert {*visit.places[:, 0].tolist()} == {5.0}


def test_a_ship_begins_with_its_first_true_report_and_what_two_stations_received_of_it_counts_once(tmp_path: Path) -> None:
    wild, true = "235 50.5 -1.0", "235 50.0 -1.0"
    file = ships(tmp_path, f"0 {wild}", f"0 {wild}", f"10 {true}", f"10 {true}", f"20 {true}", "30 236 91.0 -1.0")
    found = read_ships(file, SHIPS)
    assert [visit.times.tolist() for visit in found.visits] == [[10.0, 20.0]]
    assert [remark.split(":")[0] for remark in found.remarks] == [f"{file}, line {number}" for number in (2, 7)]


def test_ships_lie_east_and_north_of_the_origin(tmp_path: Path) -> None:
    file = ships(tmp_path, "0 235 50.01 -0.99", "10 235 50.01 -0.99")
    east, north = read_ships(file, SHIPS).visits[0].places[0]
    assert (east, north) == pytest.approx((717.2, 1112.4), abs=1.0)  # 0.01 degrees: 111.25 km x 0.01, and cos 50 of 111.66 km x 0.01


@pytest.mark.parametrize("place", [(50.0, -1.0), (50.3, -0.7), (49.5, -1.9), (-33.0, 179.0)])
def test_the_local_frame_and_its_inverse_agree(place: tuple[float, float]) -> None:
    frame = LocalFrame(round(place[0]), round(place[1]))
    assert frame.to_earth(*frame.to_plane(*place)) == pytest.approx(place, abs=1e-9)


def test_ships_on_both_sides_of_the_date_line_are_near_each_other(tmp_path: Path) -> None:
    file = ships(tmp_path, "0 235 -17.0 179.9", "10 236 -17.0 -179.9", "20 235 -17.0 179.9", "20 236 -17.0 -179.9")
    for origin, ways in ((179.9, (0.0, 21_300.0)), (-179.9, (-21_300.0, 0.0))):
        found = read_ships(file, RecordedSettings(kind="ships", data="x", origin=(-17.0, origin), longest_gap=60.0, longest_hole=60.0))
        assert found.remarks == ()
        assert [visit.places[0][0] for visit in found.visits] == pytest.approx(ways, abs=100.0)


def test_a_report_that_cannot_be_true_is_left_out_and_named_by_line(tmp_path: Path) -> None:
    file = ships(tmp_path, "0 235 50.0 -1.0", "5 245188000 50.8141 54.83172", "10 235 50.0 -1.0", "20 235 50.5 -1.0", "30 235 50.0 -1.0")
    found = read_ships(file, SHIPS)
    assert len(found.visits) == 1 and len(found.visits[0].times) == 3
    assert found.remarks[0].startswith(f"{file}, line 3: latitude 50.8141, longitude 54.8317: ")
    assert found.remarks[1].startswith(f"{file}, line 5: MMSI 235 at 5")


def test_of_two_reports_that_contradict_each_other_the_earlier_goes_where_the_others_agree_without_it() -> None:
    line = Line(Path("a"), 2, ())
    reports = [Report(time, x, 0.0, line) for time, x in ((0.0, 0.0), (10.0, 10.0), (11.0, 5.0), (12.0, 6.0))]
    kept, wrong = without_leaps(reports, lambda one, other: abs(other.x - one.x) / (other.time - one.time), 1.5)
    assert [report.time for report in kept] == [0.0, 11.0, 12.0] and [report.time for report, _ in wrong] == [10.0]


@pytest.mark.parametrize(
    ("head", "line", "said"),
    [
        (HEAD.replace("MMSI", "ship"), "0 1 50 -1", "line 1: column 'ship' is unknown"),
        (HEAD + ",heading", "0 1 50 -1", "line 1: column 'heading' is unknown"),
        (HEAD.replace("MMSI,", ""), "0 1 50 -1", "line 1: column 'MMSI' is missing"),
        (HEAD, "0 1 north -1", "line 2: Latitude_degrees = 'north': should be a finite number"),
    ],
)
def test_a_file_of_ships_that_breaks_its_form_is_refused_by_file_and_line(tmp_path: Path, head: str, line: str, said: str) -> None:
    file = ships(tmp_path, line, head=head)
    with pytest.raises(BadSetting) as error:
        read_ships(file, SHIPS)
    assert str(error.value).startswith(f"{file}, {said}")


@pytest.mark.parametrize("text", ["yesterday", "now", "NaT", "", "2016-01-12", "2016-13-12 13:02:11", "20160112 13:02:11"])
def test_a_time_that_is_none_is_refused(text: str, tmp_path: Path) -> None:
    file = ships(tmp_path, "0 1 50 -1")
    head, line = file.read_text().splitlines()
    file.write_text(f"{head}\n{text},{line.partition(',')[2]}\n")
    with pytest.raises(BadSetting, match=rf"line 2: Time = '{text}': should be such as 2016-01-12 13:02:11.218"):
        read_ships(file, SHIPS)


def test_times_may_end_in_z_and_an_offset_is_refused(tmp_path: Path) -> None:
    file = ships(tmp_path, "0 1 50 -1", "10 1 50 -1")
    plain = file.read_text()
    file.write_text(plain.replace(".000,", ".000Z,"))
    assert read_ships(file, SHIPS).visits[0].times.tolist() == [0.0, 10.0]
    for offset in ("+01:00", "-0500", " UTC", "GMT"):
        file.write_text(plain.replace(".000,", f".000{offset},"))
        with warnings.catch_warnings(action="error"), pytest.raises(BadSetting, match=r"line 2: Time = '.*': should be such as .*, in UTC"):
            read_ships(file, SHIPS)


def test_the_mark_that_spreadsheets_write_before_the_first_column_is_no_part_of_its_name(tmp_path: Path) -> None:
    file = ships(tmp_path, "0 1 50 -1")
    file.write_text("\ufeff" + file.read_text(), encoding="utf-8")
    assert len(read_ships(file, SHIPS).visits) == 1


def test_cells_in_quotes_are_what_they_are_without(tmp_path: Path) -> None:
    """R and many spreadsheets write them."""
    file = ships(tmp_path, "0 1 50 -1", "10 1 50.001 -1")
    plain = read_ships(file, SHIPS).visits[0].places
    file.write_text("\n".join(",".join(f'"{cell}"' for cell in line.split(",")) for line in file.read_text().splitlines()))
    np.testing.assert_array_equal(read_ships(file, SHIPS).visits[0].places, plain)


def test_a_file_in_another_encoding_says_which_is_read(tmp_path: Path) -> None:
    file = ships(tmp_path, "0 1 50 -1")
    file.write_text(file.read_text(), encoding="utf-16")
    with pytest.raises(BadSetting, match=r"ships\.csv: should be text in UTF-8$"):
        read_ships(file, SHIPS)


def test_places_far_out_are_told_in_a_few_digits(tmp_path: Path) -> None:
    file = people(tmp_path, "0 1 1e300 5", "50 1 1e300 5")
    with pytest.raises(BadSetting, match=r"they lie at x from 1e\+300 to 1e\+300 m and y from 5 to 5 m,"):
        recording_of(world_config(resolve("students03", {"recorded.data": str(file), "recorded.origin": [0.0, 0.0], "run.seconds": 2.0})))


def test_a_recording_without_a_target_in_the_arena_is_refused_with_the_places_of_all(tmp_path: Path) -> None:
    file = people(tmp_path, "0 1 101 205", "10 1 102 206", "50 1 104 208")
    options = {"recorded.data": str(file), "recorded.origin": [0.0, 0.0], "run.seconds": 2.0}
    with pytest.raises(BadSetting) as error:
        recording_of(world_config(resolve("students03", options)))
    places = "seen from there they lie at x from 101 to 103.5 m and y from 205 to 207.5 m, and should lie within the arena"
    arena = "no target is in the arena of 18.2 x 18.2 m between 0 s and 1.6 s"
    assert str(error.value) == f"recorded.origin = [0.0, 0.0]: {arena}; {places}"
    recording_of(world_config(resolve("students03", options | {"recorded.origin": [100.0, 200.0]})))


def test_a_file_with_many_impossible_lines_is_refused(tmp_path: Path) -> None:
    file = ships(tmp_path, *[f"{at} 235 {50.0 + at % 2} -1.0" for at in range(20)])
    with pytest.raises(BadSetting, match="10 of 20 lines like this: should be at most 1 %"):
        read_ships(file, SHIPS)


@pytest.mark.parametrize(("name", "most", "least"), [("students03", 62, 20), ("solent", 91, 40)])
def test_the_shipped_recordings_fill_their_arenas(name: str, most: int, least: int) -> None:
    config = world_config(resolve(name))
    targets = sources_of(config).targets
    counts = []
    for _ in range(60):
        counts.append(len(targets.ids))
        targets.step()
    assert least <= np.mean(counts) <= max(counts) <= most


def test_the_solent_has_one_report_that_cannot_be_and_people_have_none() -> None:
    wrong = [line for line in recording_of(world_config(resolve("solent"))).remarks if "left out" in line]
    assert len(wrong) == 1
    assert "solent.csv, line 8209: latitude 50.8141, longitude 54.8317: " in wrong[0]
    assert recording_of(world_config(resolve("students03"))).remarks == ()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"run.seconds": 300.0}, "run.seconds = 300: the recording ends before; should be at most 215.6"),
        ({"recorded.start": 300.0}, "recorded.start = 300: the recording ends before; should be at most 215.6"),
        ({"recorded.data": ""}, "recorded.data: is missing; `--data PATH` says where the files of this world are"),
        ({"recorded.data": "/nowhere.txt"}, "recorded.data = '/nowhere.txt': No such file or directory"),
    ],
)
def test_a_recording_that_is_not_there_or_too_short_is_named(options: dict[str, object], said: str) -> None:
    with pytest.raises(BadSetting) as error:
        recording_of(world_config(resolve("students03", options)))
    assert str(error.value) == said


def test_files_are_read_once_as_long_as_they_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Checks, remarks and the run ask for the recording."""
    reads = []

    def read(path: Path, settings: RecordedSettings) -> RecordedWorld:
        reads.append(path)
        return read_pedestrians(path, settings)

    monkeypatch.setitem(READERS, "pedestrians", read)
    found = []
    for place in ("5", "6.5"):
        file = people(tmp_path, f"0 1 {place} 5", "20 1 5 5")
        config = world_config(resolve("quick", {"recorded.kind": "pedestrians", "recorded.data": str(file), "run.seconds": 0.5}))
        for _ in range(2):
            recording_of(config)
            found.append(sources_of(config).targets.positions.tolist())
    assert reads == [file, file]
    assert found == [[[5.0, 5.0]]] * 2 + [[[6.5, 5.0]]] * 2


def test_the_last_tick_of_a_run_lies_within_the_recording(tmp_path: Path) -> None:
    """Of a recording of 4 s: in ticks of 0.25 s the last of 17 is its end, where everybody is still there."""
    file = people(tmp_path, *(f"{frame} 1 5 5" for frame in range(0, 101, 10)))
    given = {"recorded.kind": "pedestrians", "recorded.data": str(file), "run.dt": 0.25}
    whole = world_config(resolve("quick", {**given, "run.seconds": 4.25}))
    targets = sources_of(whole).targets
    for _ in range(whole.run.ticks - 1):
        targets.step()
    assert (targets.tick, len(targets.ids)) == (16, 1)
    with pytest.raises(BadSetting, match=r"^run\.seconds = 4\.5: the recording ends before; should be at most 4\.0$"):
        recording_of(world_config(resolve("quick", {**given, "run.seconds": 4.5})))
