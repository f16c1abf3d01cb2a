"""Bodies as processes of their own, each beside its agent; nothing is called world."""

import itertools
import json
import math
import subprocess
import time
from pathlib import Path

import pytest

from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol.codec import encode
from protocol.keys import message_key
from protocol.messages import BodyPose, Halt, Observation
from protocol.node import Gone
from tests.live.harness import PATIENT, Covey, Journal, rows
from tests.live.test_security import RUN, YOUNG, Stranger, stranger_config, with_keys

pytestmark = pytest.mark.live
TEAM = ("--team", "E8", "--bodies", "own", "--seconds", "10", "--seed", "3")
LIES = {"s1": (9.75, 9.75), "s2": (0.25, 0.25)}  # what a holder of the certificate of s1 says of both, m
STILL = 1e-9  # m between two observations


def simulated() -> str:
    return Simulation(resolve("convergence", {"team.composition": "E8", "run.seconds": 10.0, "run.seed": 3})).run().transcript


def speeds(journal: Journal, name: str, start: float, end: float = math.inf) -> list[tuple[float, float]]:
    """When a body was observed, and how far it had moved since the observation before, m."""
    seen = [(at, message.pose) for at, message in journal.said(Observation) if message.recipient == name]
    moved = [(at, math.dist(pose[:2], before[:2])) for (_, before), (at, pose) in itertools.pairwise(seen)]
    return [(at, distance) for at, distance in moved if start <= at <= end]


def ticks_without_command(logs: Path) -> int:
    """The ticks of all bodies that ended before their command came."""
    entries = [json.loads(line) for log in logs.glob("*.body.jsonl") for line in log.read_text().splitlines()]
    return sum(entry.get("ticks_without_command", 0) for entry in entries)


@pytest.mark.slow
@pytest.mark.nightly
def test_eight_agents_and_eight_bodies_walk_the_way_of_the_world_driven_run_to_the_last_bit(covey: Covey) -> None:
    result = covey.result("up", "convergence", "--lockstep", "--record", *TEAM, *PATIENT)
    assert result["transcript"] == simulated()
    assert "world" not in {Path(log).stem for log in (covey.runs / "latest" / "logs").glob("*.jsonl")}
    code, scored, complaints = covey.run("score", "latest")  # the recording holds the Truths that the monitor has computed
    assert code == 0 and "largest difference to the figures of the run itself: 0" in scored, (scored, complaints)
    assert result["ticks"] == 40 and max(result["hole_area"], result["overlap_area"]) <= 1e-6


@pytest.mark.alone  # who is late misses a round, and bits differ
@pytest.mark.nightly
def test_in_real_time_too_without_any_conductor(covey: Covey) -> None:
    """At least one run of three; one that is disturbed by something else on the machine says so."""
    expected, disturbed = simulated(), []
    while len(disturbed) < 3:
        result = covey.result("up", "convergence", "--rate", "1", *TEAM, *PATIENT)
        if result["transcript"] == expected:
            return
        rate = result["tick_rate"]
        disturbed.append(ticks_without_command(covey.runs / "latest" / "logs") + rate["late"] + rate["skipped"])
        assert disturbed[-1], "a run differs, and nobody was late"
    raise AssertionError(f"three runs were disturbed: {disturbed} things came late")


@pytest.mark.alone  # it measures how soon the hole is closed
def test_after_sigkill_of_any_three_processes_the_hole_is_closed_and_no_other_body_stops(covey: Covey) -> None:
    covey.start("up", "ledger.toml", "--rate", "1", "--seconds", "1000", "--bodies", "own", "--control", "random", "--record", *PATIENT)
    covey.wait(lambda data: data["swarm"]["tick"] >= 12 and all(row["state"] == "running" for row in data["processes"]))
    assert "world" not in rows(covey.status())
    killed = time.time()
    assert covey.run("kill", "s2", "s4.body", "s7.body")[0] == 0
    end = covey.wait(lambda data: data["swarm"]["tick"] >= 32)
    assert [row["name"] for row in end["processes"] if row["state"] == "dead"] == ["s4.body", "s7.body", "s2"]
    assert covey.run("down")[0] == 0
    journal = Journal(covey)
    gone = [at for name in ("s2", "s4", "s7") for at, _ in journal.tokens(Gone, name)[:1]]  # when the tokens went, not the command began
    # the newest tick then; tokens may go before the next one
    first = max(message.tick for _, message in journal.said(Observation, killed - 1.0, max(gone)))
    holes = [tick for tick, score in journal.scores.items() if score.hole > 1e-6 and score.tick >= first - 4]
    closed = max([*holes, first]) + 1
    print(
        f"closed {0.25 * (closed - first):.2f} s after the last death; mass from {min(journal.masses(closed)):.4f}; holes {holes}, {first}"
    )
    assert closed - first <= 4
    assert min(journal.masses(closed)) >= 0.99
    for name in ("s1", "s3", "s5", "s6", "s8"):
        assert max(distance for _, distance in speeds(journal, name, killed + 1.0)) > STILL
    dead = journal.tokens(Gone, "s2")[0][0]
    assert max(distance for _, distance in speeds(journal, "s2", dead + 0.5)) <= STILL  # its agent is dead


@pytest.mark.alone
def test_halt_makes_all_stand_within_half_a_second_until_release(covey: Covey) -> None:
    covey.start("up", "ledger.toml", "--rate", "1", "--seconds", "1000", "--bodies", "own", "--control", "random", "--record", *PATIENT)
    covey.wait(lambda data: data["swarm"]["tick"] >= 8)
    code, output, complaints = covey.run("halt")
    halted = time.time()
    assert (code, output) == (0, "8 bodies stand; `covey release` lets them go on\n"), complaints
    tick = covey.status()["swarm"]["tick"]
    assert covey.run("kill", "s3.body")[0] == 0
    covey.wait(lambda data: rows(data)["s3.body"]["state"] == "dead")
    assert covey.run("restart", "s3.body")[0] == 0
    covey.wait(lambda data: data["swarm"]["tick"] >= tick + 8)
    released = time.time()
    assert covey.run("release")[:2] == (0, "released 8 bodies\n")
    covey.wait(lambda data: data["swarm"]["tick"] >= tick + 24)
    assert covey.run("down")[0] == 0
    journal = Journal(covey)
    assert {message.incarnation for _, message in journal.said(Observation) if message.recipient == "s3"} == {1, 2}
    for number in range(1, 9):
        assert max(distance for _, distance in speeds(journal, f"s{number}", halted, released)) <= STILL
        assert max(distance for _, distance in speeds(journal, f"s{number}", released + 1.5)) > STILL
    ordered = journal.said(Halt)[0][0]
    moving = [at for number in range(1, 9) for at, distance in speeds(journal, f"s{number}", 0.0, released) if distance > STILL]
    print(f"the last move was observed {max(moving) - ordered:.2f} s after the first order")
    assert max(moving) <= ordered + 0.5


@pytest.mark.slow
def test_under_certificates_the_operator_halts_and_an_agent_does_not(covey: Covey) -> None:
    """Three agents with bodies over TLS. What s1's certificate may write is heard; its halt, and an observation of s2, are not."""
    assert covey.run("keys", "s1", "s2", "s3", "monitor", "operator", "--into", "ours")[0] == 0
    words = ("--set", "team.composition=L3", "--control", "random", "--run", RUN, "--keys", "ours", "--record")
    covey.start("up", "ledger.toml", "--rate", "1", "--seconds", "1000", "--bodies", "own", *words, *PATIENT)
    covey.wait(lambda data: data["swarm"]["tick"] >= 8)
    config = stranger_config(covey.seeds(), with_keys(covey.folder / "ours"), "s1")
    lie = Observation(sender="s2", incarnation=YOUNG, recipient="s2", tick=1, time=0.25, pose=(1.0, 1.0, 0.0))
    insider = Stranger(config)
    try:
        tick = covey.status()["swarm"]["tick"]
        while covey.status()["swarm"]["tick"] < tick + 12:
            for message in (Halt(sender="operator", incarnation=YOUNG, held=True), lie):
                insider._session.put(message_key(RUN, message), encode(message))
            time.sleep(0.1)
        begun = time.time() - 2.0
        assert covey.run("halt")[:2] == (0, "3 bodies stand; `covey release` lets them go on\n")
    finally:
        insider.close()
    halted = covey.status()["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] >= halted + 4)
    assert covey.run("down")[0] == 0
    journal = Journal(covey)
    orders = journal.said(Halt)
    assert orders and all(message.incarnation < YOUNG for _, message in orders)
    assert all(message.incarnation < YOUNG for _, message in journal.said(Observation))
    for name in ("s1", "s2", "s3"):  # they moved all the time until the operator spoke
        assert max(distance for _, distance in speeds(journal, name, begun, orders[0][0])) > STILL
        assert max(distance for _, distance in speeds(journal, name, orders[0][0] + 0.5)) <= STILL


@pytest.mark.slow
@pytest.mark.nightly
def test_under_certificates_bodies_say_where_they_are_and_keep_away_from_a_wreck(covey: Covey) -> None:
    """Three robots in a small arena over TLS; the agent of s3 is killed, and then its body. s1 forges a pose of s2, which nobody hears."""
    assert covey.run("keys", "s1", "s2", "s3", "monitor", "operator", "--into", "ours")[0] == 0
    arena = ("--set", "team.composition=L3", "--set", "arena.width=10", "--set", "arena.height=10", "--set", "limits.radius=0.5")
    words = ("--bodies", "own", "--control", "random", "--rate", "1", "--seconds", "1000", "--run", RUN, "--keys", "ours", "--record")
    covey.start("up", "ledger.toml", *words, *arena, *PATIENT)
    insider: Stranger | None = None
    try:
        for victim in ("s3", "s3.body"):
            tick = covey.wait(lambda data: data["swarm"]["tick"] >= 12)["swarm"]["tick"]
            insider = insider or Stranger(stranger_config(covey.seeds(), with_keys(covey.folder / "ours"), "s1"))
            assert covey.run("kill", victim)[0] == 0
            while covey.status()["swarm"]["tick"] < tick + 40:
                for sender, place in LIES.items():
                    lie = BodyPose(sender=sender, incarnation=YOUNG, tick=tick, pose=(*place, 0.0))
                    insider._session.put(message_key(RUN, lie), encode(lie))
                time.sleep(0.1)
    finally:
        if insider is not None:
            insider.close()
    assert covey.run("down")[0] == 0
    journal = Journal(covey)
    wreck = [message.pose[:2] for _, message in journal.said(Observation) if message.recipient == "s3"][-1]
    last = max(message.tick for _, message in journal.said(Observation))

    def told_to(name: str) -> list[Observation]:
        return [message for _, message in journal.said(Observation) if message.recipient == name]

    told = [message for message in told_to("s2") if message.tick >= last - 20]
    assert [message.obstacles.tolist() for message in told if math.dist(message.pose[:2], wreck) < 4.9] != []
    for message in told:
        near = [place for place in message.obstacles.tolist() if math.dist(place, wreck) < 1e-9]
        assert len(near) == (math.dist(message.pose[:2], wreck) <= 5.0)
    places_told = {name: {tuple(place) for seen in told_to(name) for place in seen.obstacles.tolist()} for name in ("s1", "s2", "s3")}
    assert LIES["s1"] in places_told["s2"], "the insider's link works"
    assert not any(LIES["s2"] in places for places in places_told.values())
    places: dict[int, dict[str, tuple[float, float]]] = {}
    for _, message in journal.said(Observation):
        places.setdefault(message.tick, {})[message.recipient] = message.pose[:2]
    gaps = [math.dist(*pair) for seen in places.values() for pair in itertools.combinations({"s3": wreck, **seen}.values(), 2)]
    print(f"least distance of two middles {min(gaps):.3f} m; {len(places)} ticks")
    assert min(gaps) >= 1.0


PLATFORMS = """
class Walker:
    def __init__(self, name):
        self.name = name
    def read(self, tick):
        return ({pose}, 1.0, 0.0), None
    def drive(self, velocity, turn_rate):
        pass
    {stop}
"""
STOP = "def stop(self): print(self.name, 'stands', flush=True)"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "complaint"),
    [
        pytest.param(
            PLATFORMS.format(pose="float('nan') if self.name == 's2' and tick > 3 else 5.0", stop=STOP),
            "returned the pose (nan, 1.0, 0.0)",
            marks=pytest.mark.nightly,
        ),
        (PLATFORMS.format(pose="1 / 0 if self.name == 's2' and tick > 3 else 5.0", stop=STOP), "raised ZeroDivisionError"),
    ],
)
def test_a_platform_that_fails_ends_its_own_body_with_one_line_and_the_others_go_on(covey: Covey, source: str, complaint: str) -> None:
    (covey.folder / "robots.py").write_text(source)
    words = ("--bodies", "own", "--set", "bodies.platform=robots:Walker", "--set", "team.composition=L3", "--rate", "1", "--seconds", "30")
    run = covey.start("up", "ledger.toml", *words)
    data = covey.wait(lambda data: data["swarm"]["tick"] >= 16)
    assert [row["name"] for row in data["processes"] if row["state"] == "dead"] == ["s2.body"]
    assert covey.run("down")[0] == 0
    output, _ = run.communicate(timeout=30)
    [line] = [line for line in output.splitlines() if "s2.body died" in line]
    assert complaint in line and "robots:Walker.read(4)" in line
    log = (covey.runs / "latest" / "logs" / "s2.body.jsonl").read_text()
    assert "s2 stands" in log


@pytest.mark.slow
def test_bad_input_is_refused_in_one_line(covey: Covey) -> None:
    (covey.folder / "robots.py").write_text(PLATFORMS.format(pose="5.0", stop=""))
    for words, complaint in [
        (("--set", "bodies.platform=robots:Walker"), "bodies.platform = 'robots:Walker': robots:Walker: the class has no method stop"),
        (("--set", f"bodies.epoch={time.time() + 7200.0}"), "s ahead of this machine's clock"),
        (("--lockstep", "--set", "bodies.epoch=1.0"), "lockstep has no clock"),
    ]:
        code, _, complaints = covey.run("up", "ledger.toml", "--bodies", "own", "--seconds", "5", "--team", "L2", *words)
        assert code == 2 and complaint in complaints.splitlines()[-1], complaints
        assert sum("bodies." in line for line in complaints.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.nightly
def test_a_second_body_of_an_agent_ends_the_older_one_and_the_others_go_on(covey: Covey) -> None:
    covey.start("up", "ledger.toml", "--rate", "1", "--seconds", "1000", "--bodies", "own")
    covey.running()
    words = ("--body", "s3", "--config", str(covey.runs / "latest" / "run.toml"), "--incarnation", "9", "--supervised")
    second: subprocess.Popen[str] = covey.start(*words, module="world")
    data = covey.wait(lambda data: rows(data)["s3.body"]["state"] == "dead")
    assert rows(data)["s3.body"]["end"] == "exit code 3: a younger process of this name has taken over"
    tick = data["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] >= tick + 8 and rows(data)["s3"]["tick"] >= tick + 4)
    assert second.poll() is None
    assert covey.run("down")[0] == 0
