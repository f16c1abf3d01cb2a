"""What the start of a run waits for, in words."""

from pathlib import Path

from deploy.live.startup import HOLD, Startup
from deploy.scenario import resolve
from deploy.scoring.scorer import Scorer
from protocol.node import Alive


def test_when_no_agent_is_heard_for_long_the_logs_are_named(tmp_path: Path) -> None:
    scenario = resolve("quick", {"team.composition": "A2"})
    scorer = Scorer(scenario)
    start = Startup(list(scenario.members), [], scorer, None, tmp_path / "logs" / "zygote.jsonl")
    assert start.waiting() == "there are 0 of 2 agents (without s1, s2)"
    start._prepared -= 2.0 * HOLD
    assert start.waiting().startswith("there are 0 of 2 agents (without s1, s2); none is heard") and start.waiting().endswith("logs")
    scorer.handle(Alive("agent", "s1", 1), 0.0)
    assert start.waiting() == "there are 1 of 2 agents (without s2)"
