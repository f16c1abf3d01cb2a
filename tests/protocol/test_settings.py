"""Settings: every error is one line that names the file, the field, the value and what would be right."""

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.codec import decode, encode
from protocol.keys import message_key
from protocol.messages import Hello
from protocol.sensing import SENSOR_CLASSES, MeasurementModel, SensorModel, WedgeSensor
from protocol.settings import (
    ArenaSettings,
    BadSetting,
    CommonSettings,
    RunSettings,
    Section,
    SensorSettings,
    convert,
    load,
    load_named,
    read_toml,
    sensor_of,
)


class Listed(Section, frozen=True, kw_only=True):
    """A section for the tests: a table inside a list inside a table."""

    items: tuple[RunSettings, ...] = ()
    corner: tuple[float, float] = (0.0, 0.0)


class Whole(CommonSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All sections of these tests."""

    listed: Listed = Listed()


class Camera:
    """A sensor model of a user's own."""

    def __init__(self, reach: float = 5.0) -> None:
        self.reach = reach
        self.area = reach**2

    def probability(self, points: Any, pose: Any) -> Any:
        """Nothing is ever seen."""
        return np.zeros(len(points))

    def footprint(self, pose: Any) -> Any:
        """A triangle."""
        return np.array([[0.0, 0.0], [self.reach, 0.0], [0.0, self.reach]])


class Blind:
    """Lacks nearly everything."""

    reach = 1.0


class Uncalibrated(Camera):
    """Its reach is not known yet."""

    reach = property(lambda self: sys.exit("no file"), lambda self, value: None)  # type: ignore[assignment]


class Holed(WedgeSensor, frozen=True):
    """A wedge that does not see what is near."""

    def probability(self, points: np.ndarray, pose: Any) -> np.ndarray:
        """As the wedge says from 4 m on."""
        return np.where(np.hypot(points[:, 0] - pose[0], points[:, 1] - pose[1]) < 4.0, 0.0, super().probability(points, pose))


DISC = {"angle": 6.0, "radius": 8.0, "prob_detection": 0.9}
BEARING = MeasurementModel("bearing", 0.01, 0.0)


WRONG = [
    ({"run": {"dt": 0.0}}, "run.dt = 0.0: should be a number >= 0.01"),
    ({"run": {"dt": math.nan}}, "run.dt = nan: should be a number >= 0.01"),
    ({"run": {"dt": 11}}, "run.dt = 11: should be a number <= 10.0"),
    ({"run": {"dt": "fast"}}, "run.dt = 'fast': should be a number, got a text"),
    ({"network": {"most_per_second": 0}}, "network.most_per_second = 0: should be a whole number >= 1"),
    ({"network": {"most_per_second": 1.5}}, "network.most_per_second = 1.5: should be a whole number, got a number"),
    ({"network": {"most_per_second": True}}, "network.most_per_second = True: should be a whole number, got true or false"),
    ({"run": {"clock": "sundial"}}, "run.clock = 'sundial': should be one of realtime, lockstep"),
    ({"run": {"name": "two words"}}, "run.name = 'two words': should be 1 to 64 letters, digits, or any of _ . -"),
    ({"run": {"name": "newline\n"}}, "run.name = 'newline\\n': should be 1 to 64 letters, digits, or any of _ . -"),
    ({"run": {"nane": 1}}, "run.nane: there is no such field; did you mean name?"),
    ({"run": 3}, "run = 3: should be a table, got a whole number"),
    ({"rum": {}}, "rum: there is no such field; did you mean run?"),
    ({"zzz": {}}, "zzz: there is no such field; known are run, arena, detection, limits, network, sensors, members, listed"),
    ({"arena": {"width": math.inf}}, "arena.width = inf: should be a number <= 500000.0"),
    ({"arena": {"height": -4.0}}, "arena.height = -4.0: should be a number > 0.0"),
    ({"detection": {"clutter": -0.1}}, "detection.clutter = -0.1: should be a number >= 0.0"),
    ({"network": {"listen": "tcp/x"}}, "network.listen = 'tcp/x': should be a list, got a text"),
    ({"network": {"listen": ["tcp/x", 3]}}, "network.listen[1] = 3: should be a text, got a whole number"),
    ({"network": {"insecure": 1}}, "network.insecure = 1: should be true or false, got a whole number"),
    ({"sensors": {"A": {}, "X": {"angle": 400.0}}}, "sensors.X.angle = 400.0: should be a number <= 360.0"),
    ({"sensors": {"X": {"radius": 0}}}, "sensors.X.radius = 0: should be a number >= 0.001"),
    ({"sensors": {"X": {"prob_detection": 2.0}}}, "sensors.X.prob_detection = 2.0: should be a number <= 1.0"),
    ({"sensors": {"X": {"raduis": 2.0}}}, "sensors.X.raduis: there is no such field; did you mean radius?"),
    ({"sensors": {"X": 3}}, "sensors.X = 3: should be a table, got a whole number"),
    ({"members": {"s1": "A", "s2": 7}}, "members.s2 = 7: should be a text, got a whole number"),
    ({"members": {"s1": "A", "s 2": "A"}}, "members = 's 2': should be 1 to 64 letters, digits, or any of _ . -"),
    ({"listed": {"items": [{}, {"dt": 99.0}]}}, "listed.items[1].dt = 99.0: should be a number <= 10.0"),
    ({"listed": {"items": [{"d": 1.0}]}}, "listed.items[0].d: there is no such field; did you mean dt?"),
    ({"listed": {"corner": [1.0]}}, "listed.corner = [1.0]: should be a list of length 2, got 1"),
    ({"listed": {"corner": [1.0, "x"]}}, "listed.corner[1] = 'x': should be a number, got a text"),
]


@pytest.mark.parametrize(("data", "complaint"), WRONG, ids=[complaint.partition(":")[0] for _, complaint in WRONG])
def test_a_wrong_setting_is_told_with_file_field_value_and_what_would_be_right(data: dict[str, Any], complaint: str) -> None:
    with pytest.raises(BadSetting) as caught:
        convert(data, Whole, "swarm.toml")
    assert str(caught.value) == f"swarm.toml: {complaint}"


def test_a_missing_field_is_named() -> None:
    class Needy(Section, frozen=True, kw_only=True):
        verb: str

    class Outer(Section, frozen=True, kw_only=True):
        faults: tuple[Needy, ...]

    with pytest.raises(BadSetting) as caught:
        convert({"faults": [{}]}, Outer, "swarm.toml")
    assert str(caught.value) == "swarm.toml: faults[0] = {}: the field verb is missing"


def test_no_settings_at_all_give_the_defaults() -> None:
    assert convert({}, CommonSettings, "nothing") == CommonSettings()


def test_a_process_passes_over_the_sections_of_others() -> None:
    assert convert({"somebody": {"elses": 1}, "arena": {"width": 5}}, CommonSettings, "x").arena == ArenaSettings(width=5.0)


def test_the_number_of_ticks_is_the_rounded_quotient_and_never_zero() -> None:
    assert RunSettings(seconds=200.0, dt=0.25).ticks == 800
    assert RunSettings(seconds=1.0, dt=0.3).ticks == 3
    assert RunSettings(seconds=0.01, dt=10.0).ticks == 1


def test_a_file_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text('[run]\nrate = 7\n[members]\ns1 = "A"\n', encoding="utf-8")
    settings = load(path, CommonSettings)
    assert (settings.run.rate, settings.members) == (7.0, {"s1": "A"})


def test_a_file_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match=r"absent\.toml: there is no such file"):
        read_toml(tmp_path / "absent.toml")


def test_a_folder_in_place_of_a_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match=f"{tmp_path.name}: "):
        read_toml(tmp_path)


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    """As editors of Windows write it."""
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbf[run]\nseed = 3\n")
    assert read_toml(tmp_path / "a.toml") == {"run": {"seed": 3}}


@pytest.mark.parametrize("content", [b"[run\n", b"a = \n", b"\xff\xfe", b"a = 1\na = 2\n"])
def test_a_file_that_is_no_toml_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(BadSetting, match=r"broken\.toml: not a TOML file: ") as caught:
        read_toml(path)
    assert "\n" not in str(caught.value)


def test_the_sensors_of_the_paper_are_there_without_being_declared() -> None:
    assert sensor_of(CommonSettings(), "D") is SENSOR_CLASSES["D"]


def test_a_sensor_of_the_scenario_comes_before_one_of_the_paper() -> None:
    settings = convert({"sensors": {"A": {"angle": 90.0, "radius": 3.0, "prob_detection": 0.5}}}, CommonSettings, "x")
    assert sensor_of(settings, "A") == WedgeSensor(math.pi / 2.0, 3.0, 0.5)


@pytest.mark.parametrize(
    ("given", "sensor"),
    [
        ({"prob_detection": 0.5}, WedgeSensor(math.radians(240.0), 8.0, 0.5)),
        ({"radius": 12.0}, WedgeSensor(math.radians(240.0), 12.0, 0.99)),
        ({"angle": 90.0}, WedgeSensor(math.pi / 2.0, 8.0, 0.99)),
        ({"prob_detection_far": 0.3}, WedgeSensor(math.radians(240.0), 8.0, 0.99, None, 0.3)),
    ],
)
def test_what_a_class_of_the_paper_is_not_given_is_that_of_the_paper(given: dict[str, float], sensor: WedgeSensor) -> None:
    assert sensor_of(convert({"sensors": {"A": given}}, CommonSettings, "x"), "A") == sensor


@pytest.mark.parametrize("smallest", [{"angle": 1.0e-4, "radius": 5.0}, {"angle": 90.0, "radius": 1.0e-3}], ids=["angle", "radius"])
def test_every_wedge_that_a_scenario_may_name_is_taken_from_the_wire_too(smallest: dict[str, float]) -> None:
    """A class that loads here and is refused in every Hello would leave its agents without a sensor in the eyes of all others."""
    sensor = sensor_of(convert({"sensors": {"X": smallest}}, CommonSettings, "x"), "X")
    assert isinstance(sensor, WedgeSensor)
    hello = Hello(sender="s1", incarnation=1, sensor=sensor)
    assert decode(message_key("run", hello), encode(hello)) == hello


@pytest.mark.parametrize(("field", "value", "least"), [("angle", 9.9e-5, "0.0001"), ("radius", 9.9e-4, "0.001")])
def test_a_smaller_wedge_is_refused_at_load(field: str, value: float, least: str) -> None:
    with pytest.raises(BadSetting, match=rf"x: sensors\.X\.{field} = {value}: should be a number >= {least}"):
        convert({"sensors": {"X": {"angle": 90.0, "radius": 5.0, field: value}}}, CommonSettings, "x")


def test_360_degrees_is_a_full_disc() -> None:
    assert sensor_of(CommonSettings(sensors={"X": SensorSettings(angle=360.0, radius=3.0)}), "X") == WedgeSensor(2.0 * math.pi, 3.0, 1.0)


def test_a_sensor_model_of_the_users_own_is_built_with_its_parameters() -> None:
    camera = sensor_of(CommonSettings(sensors={"X": SensorSettings(model=f"{__name__}:Camera", parameters={"reach": 9.0})}), "X")
    assert isinstance(camera, SensorModel) and (camera.reach, camera.area) == (9.0, 81.0)


def test_a_class_that_derives_from_the_wedge_is_asked_itself() -> None:
    """The world asked it and the agents took it for a wedge, so that nothing was tracked."""
    sensor = sensor_of(CommonSettings(sensors={"X": SensorSettings(model=f"{__name__}:Holed", parameters=DISC)}), "X")
    assert not isinstance(sensor, WedgeSensor)
    np.testing.assert_array_equal(sensor.probability(np.array([[3.0, 0.0], [5.0, 0.0]]), (0.0, 0.0, 0.0)), [0.0, 0.9])


@pytest.mark.parametrize(
    ("sensor", "complaint"),
    [
        (SensorSettings(radius=3.0), "sensors.X: a wedge needs an angle"),
        (SensorSettings(angle=3.0), "sensors.X: a wedge needs an angle"),
        (SensorSettings(angle=3.0, radius=3.0, range_noise=0.1), "sensors.X: range_noise, bearing_noise: a sensor of positions has"),
        (SensorSettings(angle=3.0, radius=3.0, bearing_noise=2.0), "sensors.X: range_noise, bearing_noise: a sensor of positions has"),
        (SensorSettings(model="camera"), "sensors.X: 'camera' should read module:Name"),
        (SensorSettings(model=":Camera"), "sensors.X: ':Camera' should read module:Name"),
        (SensorSettings(model=".here:Camera"), "sensors.X: '.here:Camera' should read module:Name"),
        (SensorSettings(model="no_such_module:Camera"), "sensors.X: No module named 'no_such_module'"),
        (SensorSettings(model="math:Camera"), "sensors.X: module math has no Camera; it is <module 'math' "),
        (SensorSettings(model=f"{__name__}:Camera", parameters={"rich": 1}), "sensors.X: .*rich"),
        (
            SensorSettings(model=f"{__name__}:Uncalibrated"),
            "sensors.X: .*:Uncalibrated raised SystemExit: no file \\(test_settings.py, line",
        ),
        (
            SensorSettings(model=f"{__name__}:Holed", parameters={**DISC, "measures": BEARING}),
            "sensors.X: .*:Holed.measures: should be None",
        ),
        (SensorSettings(model=f"{__name__}:Blind"), "sensors.X: .*:Blind lacks area, probability, footprint of"),
    ],
)
def test_a_sensor_that_cannot_be_built_names_its_section_and_the_reason(sensor: SensorSettings, complaint: str) -> None:
    with pytest.raises(BadSetting, match=complaint):
        sensor_of(CommonSettings(sensors={"X": sensor}), "X")


def test_an_unknown_sensor_class_lists_the_known_ones() -> None:
    with pytest.raises(BadSetting, match="sensor class 'Z' does not exist; known are X, A, B, C, D, E, F, G, H"):
        sensor_of(CommonSettings(sensors={"X": SensorSettings()}), "Z")


def test_a_named_object_is_loaded() -> None:
    assert load_named("math:pi") == math.pi
