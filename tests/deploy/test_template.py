"""`covey init`: a file with every section, every setting and every default; made from the types, so nothing can be missing."""

import re
from pathlib import Path

import msgspec
import pytest

from deploy.cli.scenario_file import init
from deploy.cli.template import dotted_names, template
from deploy.scenario import FaultSettings, Scenario, resolve
from protocol.settings import BadSetting, SensorSettings

SETTING = re.compile(r"^# (\w+) = (.*?)(?:  +# .*)?$", re.MULTILINE)


def empty(folder: Path) -> Path:
    """A scenario that says nothing but that it is one."""
    path = folder / "empty.toml"
    path.write_text("[run]\n", encoding="utf-8")
    return path


def plain(scenario: Scenario) -> Scenario:
    """Without the name of its file, and without a word of what that does not say."""
    return msgspec.structs.replace(scenario, run=msgspec.structs.replace(scenario.run, scenario="", derived=()))


@pytest.mark.parametrize("options", [{}, {"run.clock": "lockstep"}])
def test_the_file_as_written_means_the_same_as_no_settings_at_all(options: dict[str, str], tmp_path: Path) -> None:
    assert init(tmp_path / "mine.toml") == 0
    assert plain(resolve(str(tmp_path / "mine.toml"), options)) == plain(resolve(str(empty(tmp_path)), options))


def test_with_every_default_taken_from_its_comment_the_scenario_is_still_the_same(tmp_path: Path) -> None:
    text = re.sub(r"^# \[[^\]].*?(?=^\[)", "", template() + "[", flags=re.MULTILINE | re.DOTALL).rstrip("[")  # but for what needs a name
    given = SETTING.sub(lambda match: "" if match[2].startswith("<") else f"{match[1]} = {match[2]}", text)
    assert len(re.findall(r"^\w+ = ", given, re.MULTILINE)) >= len(dotted_names()) - 5
    path = tmp_path / "given.toml"
    path.write_text(given, encoding="utf-8")
    assert plain(resolve(str(path))) == plain(resolve(str(empty(tmp_path))))


def test_every_setting_of_every_section_is_there_once() -> None:
    named = [match[1] for match in SETTING.finditer(template())]
    more = [*SensorSettings.__struct_fields__, *FaultSettings.__struct_fields__]
    assert sorted(named) == sorted([name.split(".")[1] for name in dotted_names()] + more)
    assert {"run.seed", "filter.halo", "network.link_faults", "bodies.poses", "targets.count"} <= set(dotted_names())


def test_comments_limits_and_choices_stand_beside_the_setting() -> None:
    text = template()
    assert re.search(r'^# kind = "power" +# one of power, voronoi, voronoi-cod$', text, re.MULTILINE)
    assert re.search(r"^# dt = 0.25 +# world time between ticks, s; >= 0.01, <= 10$", text, re.MULTILINE)
    assert re.search(r"^# angle = <number> +# viewing angle, degrees; >= 0.0001, <= 360$", text, re.MULTILINE)


def test_a_file_that_exists_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("precious", encoding="utf-8")
    with pytest.raises(BadSetting, match=r"mine\.toml: exists and is left as it is"):
        init(path)
    assert path.read_text() == "precious"
