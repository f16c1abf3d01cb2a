"""Every figure of a score stands under its own name in the metrics, and an agent that has gone is down."""

import msgspec
import pytest

from deploy.page.frames import CURVES, greeting, moment
from deploy.page.metrics import PageFigures, metrics_page
from deploy.page.picture import Picture
from deploy.scenario import resolve
from deploy.scoring.scores import Score
from protocol.node import Alive, Gone
from tests.deploy.test_metrics import played, samples

FIGURES = {
    "ospa_meters": 1.25,
    "gospa_meters": 2.25,
    "targets": 30.0,
    "targets_in_view": 21.0,
    "targets_estimated": 27.0,
    "mass": 28.5,
    "hole_ratio": 0.125,
    "overlap_ratio": 0.0625,
}


def test_no_figure_of_the_score_stands_under_the_name_of_another() -> None:
    score = Score(tick=3, time=0.75, ospa=1.25, gospa=2.25, targets=30, in_view=21, estimated=27, mass=28.5, hole=0.125, overlap=0.0625)
    found = samples(metrics_page(Picture(played(1)[0].scenario), score, PageFigures()).decode())
    assert {name: found[f"covey_{name}", 'run="covey"'] for name in FIGURES} == FIGURES


@pytest.mark.parametrize("count", [0, 3])
def test_without_true_targets_neither_metrics_nor_page_compare_with_them(count: int) -> None:
    picture = Picture(resolve("quick", {"targets.count": count}))
    score = Score(tick=3, time=0.75, ospa=1.25, gospa=2.25, targets=count, in_view=0, estimated=1, mass=0.5, hole=0.0, overlap=0.0)
    exported = {name.removeprefix("covey_") for name, _ in samples(metrics_page(picture, score, PageFigures()).decode())}
    assert FIGURES.keys() - exported == (set() if count else {"ospa_meters", "gospa_meters", "targets", "targets_in_view"})
    drawn = dict(zip(CURVES, moment(picture, score)["score"]))
    greeted = msgspec.json.decode(greeting(picture, [score], {}))["curves"]
    assert {name: [value] for name, value in drawn.items()} == greeted
    assert {name for name, value in drawn.items() if value is None} == (set() if count else {"ospa", "gospa", "targets"})


def test_of_an_agent_that_has_gone_only_its_counters_its_age_and_that_it_is_down_are_left() -> None:
    picture = played(10)[1]

    def named(name: str) -> set[str]:
        found = samples(metrics_page(picture, None, PageFigures()).decode())
        return {family.removeprefix("covey_agent_") for family, labels in found if f'agent="{name}"' in labels}

    gauges = {"mass", "load", "unused_square_meters", "round_seconds"}
    assert named("s3") == named("s4") > gauges
    picture.see(Gone("agent", "s3", 1), 0.0)
    assert named("s4") - named("s3") == gauges


def test_an_agent_is_up_for_as_long_as_its_token() -> None:
    picture, up = Picture(played(1)[0].scenario), []
    for event in (Alive("agent", "s3", 1), Gone("agent", "s3", 1)):
        picture.see(event, 0.0)
        up.append(samples(metrics_page(picture, None, PageFigures()).decode())["covey_agent_up", 'agent="s3",run="covey"'])
    assert up == [1.0, 0.0]
