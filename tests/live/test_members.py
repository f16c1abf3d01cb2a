"""Who comes late, comes back, or comes twice: processes started by hand beside those of the supervisor."""

import statistics
from pathlib import Path

import pytest

from protocol.messages import Gossip
from protocol.node import Alive, Gone
from protocol.observer_messages import Estimate
from tests.live.harness import PATIENT, Covey, Journal, rows

pytestmark = [pytest.mark.live, pytest.mark.slow]
LEDGER = ("up", "ledger.toml", "--rate", "1", "--seconds", "1000", "--record", *PATIENT)


def test_a_late_comer_from_outside_is_in_every_view_and_gets_a_body_and_a_cell(covey: Covey) -> None:
    covey.start(*LEDGER)
    covey.wait(lambda data: data["swarm"]["tick"] >= 8)
    covey.by_hand("s20", 1, "L")
    there = covey.wait(lambda data: rows(data).get("s20", {}).get("cell", 0.0) > 0.0)
    assert rows(there)["s20"]["state"] == "guest"
    tick = there["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > tick + 16)
    assert covey.run("down")[0] == 0

    journal = Journal(covey)
    gossips = [message for _, message in journal.said(Gossip) if message.sender == "s20"]
    spoke = gossips[0].tick
    settled = next(message.tick for message in gossips if not message.listening)
    assert gossips[0].listening and settled <= spoke + 6  # two rounds when all of them are heard in time
    last = [message for _, message in journal.said(Estimate) if message.tick > settled + 4]
    assert {message.sender for message in last} == {f"s{number}" for number in (*range(1, 9), 20)}
    views = [len({message.diagram_hash for message in last if message.tick == stamp}) for stamp in {message.tick for message in last}]
    assert statistics.median(views) == 1
    print(f"a cell {settled - spoke} ticks after its first word; mass {statistics.median(journal.masses(settled + 4)):.4f} in the median")
    assert 0.99 <= statistics.median(journal.masses(settled + 4)) <= 1.01


def test_who_comes_back_under_its_name_is_the_younger_one_and_no_mass_is_lost(covey: Covey) -> None:
    covey.start(*LEDGER)
    covey.wait(lambda data: data["swarm"]["tick"] >= 8)
    assert covey.run("kill", "s3,s6")[0] == 0
    covey.wait(lambda data: not rows(data)["s3"]["alive"] and not rows(data)["s6"]["alive"])
    assert covey.run("restart")[1] == "restarted s3, s6\n"
    back = covey.wait(lambda data: all(rows(data)[name]["alive"] and rows(data)[name]["cell"] > 0.0 for name in ("s3", "s6")))
    tick = back["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > tick + 16)
    assert covey.run("down")[0] == 0
    journal = Journal(covey)
    assert [number for _, number in journal.tokens(Alive, "s3")] == [1, 2]
    assert {message.incarnation for _, message in journal.said(Gossip) if message.sender == "s3" and message.tick > tick} == {2}
    print(f"mass {statistics.median(journal.masses(tick + 2)):.4f} in the median")
    assert 0.99 <= statistics.median(journal.masses(tick + 2)) <= 1.01
    assert statistics.median(score.overlap for score in journal.after(tick + 2)) <= 1e-6


def test_of_two_processes_with_one_name_the_older_leaves_with_code_3_and_the_user_is_told(covey: Covey) -> None:
    supervisor = covey.start(*LEDGER)
    covey.wait(lambda data: data["swarm"]["tick"] >= 8)
    covey.by_hand("s3", 1000)
    data = covey.wait(lambda data: rows(data)["s3"]["state"] == "dead" and rows(data)["s3"]["alive"])
    assert rows(data)["s3"]["end"] == "exit code 3: a younger process of this name has taken over"
    tick = data["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > tick + 16)
    assert covey.run("down")[0] == 0
    output, _ = supervisor.communicate(timeout=60)
    assert "two processes are called s3, incarnations 1 and 1000: the older one stops itself" in output
    journal = Journal(covey)
    came, left = journal.tokens(Alive, "s3")[-1], journal.tokens(Gone, "s3")[0]
    print(f"the older left {1000.0 * (left[0] - came[0]):.0f} ms after the younger came")
    assert (came[1], left[1]) == (1000, 1) and left[0] - came[0] <= 1.0
    assert 0.99 <= statistics.median(journal.masses(tick + 4)) <= 1.01


def test_who_filters_with_other_settings_is_refused_and_named_to_the_user(covey: Covey) -> None:
    supervisor = covey.start(*LEDGER)
    covey.wait(lambda data: data["swarm"]["tick"] >= 8)
    text = (covey.runs / "latest" / "agents.toml").read_text()
    assert "gate = 6.0" in text
    other = covey.folder / "other.toml"
    other.write_text(text.replace("gate = 6.0", "gate = 5.0"))
    covey.by_hand("s20", 1, "L", other)
    covey.wait(lambda data: rows(data).get("s20", {}).get("differs") == ["filter.gate"])
    assert "guest, refused: other filter" in covey.run("ps")[1]
    assert covey.run("down")[0] == 0
    output, _ = supervisor.communicate(timeout=60)
    assert "the settings of s20 are not those of the run in filter.gate: the others refuse it" in output
    warned = "the settings of s20 differ from those of s1 in filter.gate: it computes another PHD and is refused"
    assert (covey.runs / "latest" / "logs" / "s1.jsonl").read_text().count(warned) == 1


@pytest.mark.parametrize("interest", [pytest.param("all", marks=pytest.mark.nightly), "neighbours"])
def test_no_agent_process_is_given_a_word_of_the_worlds(covey: Covey, interest: str) -> None:
    """Neither its files nor its command line nor its environment hold the seed of the world or how fast targets are."""
    secrets = ("987654321", "1.73205")
    settings = (f"targets.speed={secrets[1]}", f"timing.interest={interest}")
    covey.start("up", "quick", "--seed", secrets[0], "--seconds", "1000", *(word for each in settings for word in ("--set", each)))
    covey.running()
    data = covey.status()
    assert data is not None
    for row in data["processes"]:
        if row["name"] != "world":
            known = [Path(f"/proc/{row['pid']}/{file}").read_bytes().decode() for file in ("cmdline", "environ")]
            known += [(covey.runs / "latest" / name).read_text() for name in ("agents.toml", f"logs/{row['name']}.jsonl")]
            assert str(covey.runs / "latest" / "agents.toml") in known[0] or "deploy.live.zygote" in known[0]
            assert not [secret for secret in secrets for text in known if secret in text]
    assert covey.run("down")[0] == 0
    covey.wait_until_gone()
