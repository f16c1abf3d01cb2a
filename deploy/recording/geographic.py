"""A recording on the map: GeoJSON (RFC 7946), and Cursor-on-Target events.

Rules. Both forms know places on Earth only. A recorded world of ships has an origin; any other run is given one. Times are UTC:
seconds of the world after the moment at which its time was 0. That moment is told, else it follows from the first Truth and the
recorder's clock. In lockstep, where both times go apart, the first Truth has the time at which it was recorded. The recording of a
simulation does not say it.
"""

import datetime
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from deploy.recording.recording import Recording
from deploy.recording.reported import ReportedTarget, ReportedTick, reported_ticks
from protocol.keys import parse_message_key
from protocol.settings import BadSetting
from world.recorded.local_frame import LocalFrame

DIGITS = 7  # of degrees: a centimetre
EARLIEST = 10**18  # ns of Unix time, in 2001: an earlier publish time is the world's time of a simulation
STALE = 3  # ticks for which an event of Cursor-on-Target holds
UNKNOWN_HEIGHT = "9999999.0"  # of Cursor-on-Target: not known, m
TARGET, SENSOR = {"ships": "a-u-S", "": "a-u-G"}, "a-f-G-E-S"  # unknown at sea or on the ground; a friendly sensor
HOW = "m-f"  # from the fusion of several sensors by a machine

Way = list[tuple[float, tuple[float, float]]]  # s of the world, and longitude and latitude


class Earth(NamedTuple):
    """Where (0, 0) of the arena is, and when the run began."""

    frame: LocalFrame
    began: datetime.datetime

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Longitude and latitude in degrees, as GeoJSON orders them."""
        latitude, longitude = self.frame.to_earth(x, y)
        return round(longitude, DIGITS), round(latitude, DIGITS)

    def moment(self, seconds: float) -> str:
        """The UTC time so many seconds after the beginning."""
        moment = self.began + datetime.timedelta(seconds=seconds)
        return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def earth_of(recording: Recording, origin: tuple[float, float] | None, began: str | None) -> Earth:
    """Where and when a recording was; raises BadSetting when it does not say, or for a wrong option."""
    recorded = recording.scenario.recorded
    if origin is None and recorded.kind != "ships":
        raise BadSetting("--origin: is missing; a latitude and a longitude in degrees say where (0, 0) of this arena is")
    latitude, longitude = origin or recorded.origin
    if not (abs(latitude) <= 89.0 and abs(longitude) <= 180.0):
        raise BadSetting(f"--origin {latitude:g} {longitude:g}: should be a latitude within +-89 and a longitude within +-180 degrees")
    if began is None:
        return Earth(LocalFrame(latitude, longitude), datetime.datetime.fromtimestamp(_zero_of(recording), datetime.UTC))
    try:
        moment = datetime.datetime.fromisoformat(began)
    except ValueError:
        raise BadSetting(f"--began {began}: should be such as 2016-01-12T13:02:11Z") from None
    try:
        moment = moment.astimezone(datetime.UTC) if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)
        moment + datetime.timedelta(seconds=recording.seconds + STALE * recording.scenario.run.dt)
    except OverflowError:
        raise BadSetting(
            f"--began {began}: should be such that the {recording.seconds:g} s of the recording lie in the years 1 to 9999, UTC"
        ) from None
    return Earth(LocalFrame(latitude, longitude), moment)


def _zero_of(recording: Recording) -> float:
    """The Unix time, s, at which the world's time was 0; raises BadSetting when the recording does not say."""
    run = recording.scenario.run
    truths = (entry for entry in recording.entries() if (key := parse_message_key(entry.key)) is not None and key.kind == "truth")
    first = next(truths, None)
    if first is None or first.published < EARLIEST:
        raise BadSetting(f"--began: is missing; {recording.path} does not say when the run began, as one of a simulation")
    return first.published / 1e9 - first.time / (run.rate if run.clock == "realtime" else 1.0)


def write_geojson(recording: Recording, earth: Earth, file: Path) -> int:
    """Write a collection of features: a point for each estimate, a line for each true target and each body; the number of features.

    A target or a body that was away has a line for each time that it was there.
    """
    points: list[dict[str, Any]] = []
    lines: list[tuple[str, str, Way]] = []
    before: dict[tuple[str, str], Way] = {}  # those that were there in the last tick
    for tick in reported_ticks(recording):
        time = tick.truth.time
        points += [_point(earth, one, time) for one in tick.targets]
        here = [(("target", str(name)), x, y) for name, (x, y) in zip(tick.truth.ids.tolist(), tick.truth.targets.tolist())]
        here += [(("sensor", body), x, y) for body, (x, y, _) in zip(tick.truth.bodies, tick.truth.poses.tolist())]
        now = {key: before.get(key, []) for key, _, _ in here}
        lines += [(*key, way) for key, way in now.items() if not way]
        for key, x, y in here:
            now[key].append((time, earth.place(x, y)))
        before = now
    features = [*points, *(_line(earth, kind, name, way) for kind, name, way in lines)]
    file.write_bytes(msgspec.json.encode({"type": "FeatureCollection", "features": features}))
    return len(features)


def _point(earth: Earth, one: ReportedTarget, time: float) -> dict[str, Any]:
    label = {} if one.label is None else {"label": one.label}
    properties = {"kind": "estimate", "agent": one.agent, "time": earth.moment(time), **label}
    return {"type": "Feature", "geometry": {"type": "Point", "coordinates": earth.place(one.x, one.y)}, "properties": properties}


def _line(earth: Earth, kind: str, name: str, way: Way) -> dict[str, Any]:
    """A line; a target that was there in one tick only is a point, because a line has two places."""
    places = [place for _, place in way]
    geometry = {"type": "LineString", "coordinates": places} if len(way) > 1 else {"type": "Point", "coordinates": places[0]}
    return {
        "type": "Feature",
        "geometry": geometry,
        "properties": {"kind": kind, "name": name, "times": [earth.moment(time) for time, _ in way]},
    }


def write_cot(recording: Recording, earth: Earth, file: Path) -> int:
    """Write Cursor-on-Target events, one a line, in the order of time; the number of events."""
    number = 0
    with file.open("w", encoding="utf-8") as out:
        for tick in reported_ticks(recording):
            for event in _events(recording, earth, tick):
                out.write(ElementTree.tostring(event, encoding="unicode") + "\n")
                number += 1
    return number


def _events(recording: Recording, earth: Earth, tick: ReportedTick) -> Iterator[ElementTree.Element]:
    """The events of a tick: the sensors that are alive, and the estimates."""
    scenario, alive = recording.scenario, set(tick.truth.alive)
    kind = TARGET.get(scenario.recorded.kind, TARGET[""])
    times = tick.truth.time, tick.truth.time + STALE * scenario.run.dt
    for name, (x, y, _) in zip(tick.truth.bodies, tick.truth.poses.tolist()):
        if name in alive:
            yield _event(earth, f"{recording.run}.{name}", SENSOR, name, (x, y), times, 1.0)
    for one in tick.targets:
        callsign = f"{one.agent}-{one.number}" if one.label is None else f"T{one.label}"
        yield _event(earth, f"{recording.run}.{callsign}", kind, callsign, (one.x, one.y), times, scenario.extraction.bin)


def _event(
    earth: Earth, name: str, kind: str, callsign: str, place: tuple[float, float], times: tuple[float, float], error: float
) -> ElementTree.Element:
    """One event; `error` is the radius in m within which the place holds."""
    begin, end = (earth.moment(time) for time in times)
    head = {"version": "2.0", "type": kind, "uid": name, "how": HOW, "time": begin, "start": begin, "stale": end}
    event = ElementTree.Element("event", head)
    longitude, latitude = earth.place(*place)
    longitude = math.remainder(longitude, 360.0)  # it has no places beyond the date line, which lines of GeoJSON may cross
    height = {"hae": UNKNOWN_HEIGHT, "ce": f"{error:g}", "le": UNKNOWN_HEIGHT}
    ElementTree.SubElement(event, "point", {"lat": f"{latitude:.{DIGITS}f}", "lon": f"{longitude:.{DIGITS}f}", **height})
    ElementTree.SubElement(ElementTree.SubElement(event, "detail"), "contact", {"callsign": callsign})
    return event
