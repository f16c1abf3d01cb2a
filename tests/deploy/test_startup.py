"""What the start of a run waits for, in words."""

from pathlib import Path

import pytest

from deploy.live.certificates import make_keys
from deploy.live.startup import HOLD, Startup, check_certificates
from deploy.scenario import resolve
from deploy.scoring.scorer import Scorer
from protocol.node import Alive
from protocol.settings import BadSetting


def test_when_no_agent_is_heard_for_long_the_logs_are_named(tmp_path: Path) -> None:
    scenario = resolve("quick", {"team.composition": "A2"})
    scorer = Scorer(scenario)
    start = Startup(list(scenario.members), [], scorer, None, tmp_path / "logs" / "zygote.jsonl")
    assert start.waiting() == "there are 0 of 2 agents (without s1, s2)"
    start._prepared -= 2.0 * HOLD
    assert start.waiting().startswith("there are 0 of 2 agents (without s1, s2); none is heard") and start.waiting().endswith("logs")
    scorer.handle(Alive("agent", "s1", 1), 0.0)
    assert start.waiting() == "there are 1 of 2 agents (without s2)"


def test_a_certificate_that_no_peer_would_accept_is_named_before_anything_starts(tmp_path: Path) -> None:
    make_keys(["s1", "s2", "world", "monitor"], tmp_path)
    make_keys(["s2"], tmp_path / "other")
    files = {"ca": f"{tmp_path}/ca.pem", "certificate": f"{tmp_path}/{{name}}.pem", "key": f"{tmp_path}/{{name}}.key"}
    scenario = resolve("quick", {"team.composition": "A2", **{f"network.{field}": value for field, value in files.items()}})
    check_certificates(scenario)
    for source, complaint in (
        (tmp_path / "s1", "is the certificate of s1, not of s2"),
        (tmp_path / "other" / "s2", "is not of the authority"),
    ):
        for end in (".pem", ".key"):
            (tmp_path / f"s2{end}").write_bytes(source.with_name(source.name + end).read_bytes())
        with pytest.raises(BadSetting, match=rf"s2\.pem: {complaint}"):
            check_certificates(scenario)
    with (tmp_path / "ca.pem").open("ab") as authorities:
        authorities.write((tmp_path / "other" / "ca.pem").read_bytes())
    check_certificates(scenario)  # two authorities are trusted
    make_keys(["s2"], tmp_path, days=0, force=True)
    with pytest.raises(BadSetting, match=r"s2\.pem: ran out on"):
        check_certificates(scenario)
