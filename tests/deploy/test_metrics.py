"""The metrics as Prometheus reads them: every line parses, families are together, and the numbers are those of the picture."""

import json
import re
from pathlib import Path

import msgspec

from deploy.page.metrics import PageFigures, metrics_page
from deploy.page.picture import Picture
from deploy.scenario import FaultSettings, resolve
from deploy.simulation import Simulation
from protocol.node import Rejected
from tests.reference import COUNTERS

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = re.compile(r'^([a-z_:][a-z0-9_:]*)\{((?:[a-z_]+="(?:[^"\\\n]|\\.)*",?)*)\} (-?[0-9.e+-]+|NaN|[+-]Inf)$')


def played(ticks: int) -> tuple[Simulation, Picture]:
    simulation = Simulation(resolve("quick", {"run.seconds": 10.0}))
    picture = Picture(simulation.scenario)
    simulation.scorer.on_event = picture.see
    while (picture.truth is None or picture.truth.tick < ticks) and simulation.bus.step():
        pass
    return simulation, picture


def samples(text: str) -> dict[tuple[str, str], float]:
    found = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            match = SAMPLE.match(line)
            assert match, line
            assert (match[1], match[2]) not in found, line
            found[match[1], match[2]] = float(match[3])
    return found


def test_every_family_is_announced_once_before_its_samples() -> None:
    simulation, picture = played(10)
    kind_of: dict[str, str] = {}
    family = ""
    for line in metrics_page(picture, simulation.scorer.scores[-1], PageFigures()).decode().splitlines():
        if line.startswith("# TYPE "):
            _, _, family, kind = line.split()
            assert family not in kind_of
            assert kind in ("gauge", "counter")
            assert (kind == "counter") == family.endswith("_total")
            kind_of[family] = kind
        elif not line.startswith("#"):
            assert line.startswith(family + "{")


def test_numbers_are_those_of_score_and_picture() -> None:
    simulation, picture = played(10)
    score = simulation.scorer.scores[-1]
    found = samples(metrics_page(picture, score, PageFigures(clients=2, dropped=5)).decode())
    run = 'run="covey"'
    assert found["covey_ospa_meters", run] == score.ospa
    assert found["covey_agents", run + ',state="alive"'] == 6
    assert found["covey_agent_up", 'agent="s3",' + run] == 1
    assert found["covey_messages_total", run] == picture.messages > 100
    assert found["covey_page_frames_dropped_total", run] == 5
    estimate = picture.agents["s3"].estimate
    assert estimate is not None
    assert found["covey_agent_rounds_total", 'agent="s3",' + run] == estimate.counters["rounds"]


def test_the_page_names_every_counter_that_agents_in_trouble_report() -> None:
    faults = (
        FaultSettings(at=2.0, verb="starve", who="s1", value=0.15),
        FaultSettings(at=9.0, verb="kill", who="s2", options={"silent": True}),
    )
    for ahead in (0.0, 0.5):
        scenario = resolve("quick", {"run.seconds": 14.0, "timing.look_ahead": ahead})
        simulation = Simulation(msgspec.structs.replace(scenario, faults=faults), clock="realtime", scores=False)
        picture = Picture(simulation.scenario)
        simulation.scorer.on_event = picture.see
        simulation.run()
        said = {name.partition(".")[0] for known in picture.agents.values() if known.estimate for name in known.estimate.counters}
        assert said >= {"rounds", "heard", "skipped", "spared", "stalled_ms"} and said <= set(COUNTERS), ahead
    page = (ROOT / "docs" / "reference" / "metrics.md").read_text(encoding="utf-8")
    assert all(f"`covey_agent_{name}_total`" in page for name in COUNTERS)


def test_names_from_outside_cannot_break_a_line() -> None:
    _, picture = played(1)
    picture.see(Rejected('a"b\\c\nd', "format"), 0.0)
    found = samples(metrics_page(picture, None, PageFigures()).decode())
    assert found["covey_rejected_total", 'reason="format",run="covey",sender="(other)"'] == 1
    assert not any(name == "covey_ospa_meters" for name, _ in found)


def test_the_dashboard_asks_for_nothing_that_is_not_exported() -> None:
    board = json.loads((ROOT / "deploy" / "page" / "grafana.json").read_text(encoding="utf-8"))
    asked = {name for panel in board["panels"] for target in panel["targets"] for name in re.findall(r"covey_[a-z_]+", target["expr"])}
    simulation, picture = played(10)
    picture.see(Rejected("s1", "format"), 0.0)
    exported = {name for name, _ in samples(metrics_page(picture, simulation.scorer.scores[-1], PageFigures()).decode())}
    counted_when_it_happens = {f"covey_agent_{name}_total" for name in ("late", "missing", "skipped", "rejected")}
    assert len(asked) > 15
    assert asked <= exported | counted_when_it_happens


def test_the_dashboard_is_one_that_grafana_lays_out_as_it_stands() -> None:
    board = json.loads((ROOT / "deploy" / "page" / "grafana.json").read_text(encoding="utf-8"))
    assert board["schemaVersion"] >= 36  # data sources by uid
    assert {"title", "uid", "time", "templating", "annotations", "panels"} <= set(board)
    names = {variable["name"] for variable in board["templating"]["list"]}
    taken: set[tuple[int, int]] = set()
    for panel in board["panels"]:
        place = panel["gridPos"]
        squares = {(x, y) for x in range(place["x"], place["x"] + place["w"]) for y in range(place["y"], place["y"] + place["h"])}
        assert not squares & taken
        assert all(0 <= x < 24 for x, _ in squares)
        taken |= squares
        assert panel["type"] in ("stat", "timeseries")
        assert panel["datasource"] == {"type": "prometheus", "uid": "${source}"}
        assert [target["refId"] for target in panel["targets"]] == sorted({target["refId"] for target in panel["targets"]})
        asked = re.findall(r"\$(\w+)", " ".join(target["expr"] for target in panel["targets"]))
        assert set(asked) == {"run"} <= names
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])
