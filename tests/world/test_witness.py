"""A witness that was starved: what it has missed reaches it sender by sender."""

from typing import Any

from deploy.scenario import resolve, world_config
from deploy.scoring.scorer import Scorer
from protocol.messages import Observation
from protocol.node import Alive, Gone, received
from protocol.observer_messages import Truth
from world.witness import Witness

TEAM = ("s1", "s2")
LAG, LAG_SECONDS = 3, 2.0


def at(name: str, tick: int) -> Any:
    """The event of an observation; its body moves 1 m a tick."""
    pose = 0.5 + tick, 3.0, 0.0
    return received(Observation(sender=name, incarnation=1, recipient=name, tick=tick, time=0.25 * tick, pose=pose, detections_bytes=b""))


def witness(*agents: str) -> Witness:
    """A witness that knows both bodies, and these agents."""
    config = world_config(resolve("quick", {"team.composition": "A2", "bodies.host": "own", "run.clock": "lockstep"}))
    made = Witness(config, "monitor", 1, LAG, LAG_SECONDS)
    for role, names in (("body", TEAM), ("agent", agents)):
        for name in names:
            assert not made.take(Alive(role, name, 1), 0.0)  # type: ignore[arg-type]
    return made


def take_all(made: Witness, events: list[Any], now: float) -> list[Truth]:
    return [truth for event in events for truth in made.take(event, now)]


def test_all_of_one_body_before_anything_of_the_other_gives_the_truths_of_any_other_order() -> None:
    by_tick, by_sender = witness(*TEAM), witness(*TEAM)
    usual = take_all(by_tick, [at(name, tick) for tick in range(20) for name in TEAM], 0.0)
    starved = take_all(
        by_sender, [*[at("s1", tick) for tick in range(20)], Gone("body", "s1", 1), *[at("s2", tick) for tick in range(20)]], 9.0
    )
    assert [truth.tick for truth in usual] == list(range(20))
    assert [(truth.tick, truth.poses_bytes, truth.alive) for truth in starved] == [(t.tick, t.poses_bytes, t.alive) for t in usual]


def test_an_observation_of_a_tick_after_the_run_counts_for_nothing() -> None:
    made = witness(*TEAM)
    words = [at(name, tick) for tick in range(20) for name in TEAM]
    words[7:7] = [at("s1", 50_000)]
    truths = [truth for number, word in enumerate(words) for truth in made.take(word, float(number))]
    assert [(truth.tick, truth.alive) for truth in truths] == [(tick, TEAM) for tick in range(20)]


def test_a_body_that_is_silent_for_long_is_waited_for_no_more() -> None:
    made = witness(*TEAM)
    assert not take_all(made, [at("s1", tick) for tick in range(LAG + 2)], 5.0)
    late = take_all(made, [at("s1", LAG + 2)], 5.0 + LAG_SECONDS)
    assert [(truth.tick, truth.alive) for truth in late] == [(0, ("s1",)), (1, ("s1",))]


def test_the_first_tick_waits_for_the_token_of_every_agent_and_no_later_one_does() -> None:
    made = witness("s1")
    assert not take_all(made, [at(name, tick) for tick in range(2) for name in TEAM], 0.0)
    truths = made.take(Alive("agent", "s2", 1), 0.1)
    assert [(truth.tick, truth.alive) for truth in truths] == [(0, TEAM), (1, TEAM)]
    made = witness("s1")
    take_all(made, [at(name, tick) for tick in range(LAG + 1) for name in TEAM], 0.0)
    truths = take_all(made, [at(name, LAG + 1) for name in TEAM], LAG_SECONDS)
    assert [truth.alive for truth in truths] == [("s1",)] * (LAG + 2)  # the agent is missing


def test_a_scorer_waits_as_well_for_estimates_that_it_has_only_not_read_yet() -> None:
    scenario = resolve("quick", {"team.composition": "A2", "run.clock": "lockstep"})
    scorer = Scorer(scenario)
    for name in TEAM:
        scorer.handle(Alive("agent", name, 1), 0.0)
    ahead = [Truth(sender="world", incarnation=1, tick=tick, time=0.25 * tick, bodies=TEAM, alive=TEAM, in_view=0) for tick in range(60)]
    for truth in ahead[:59]:
        scorer.handle(received(truth), 5.0)
    assert not scorer.scores
    scorer.handle(received(ahead[59]), 8.0)
    assert [score.tick for score in scorer.scores] == list(range(39))
