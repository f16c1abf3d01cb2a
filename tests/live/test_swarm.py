"""The live swarm as promised: what is simulated is what is deployed, deaths close within three ticks, garbage changes a counter."""

import asyncio
import json
import os
import tomllib
from pathlib import Path

import pytest

from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol import keys, live
from protocol.settings import NetworkSettings
from tests.live.harness import PATIENT, Covey, rows

pytestmark = pytest.mark.live


def test_sixteen_processes_in_lockstep_follow_the_simulation_to_the_last_bit(covey: Covey) -> None:
    result = covey.result("up", "convergence", "--lockstep", "--seconds", "10", "--seed", "3", *PATIENT)
    simulated = Simulation(resolve("convergence", {"run.seconds": 10.0, "run.seed": 3})).run()
    assert result["transcript"] == simulated.transcript
    assert result["ticks"] == simulated.ticks == 40
    assert result["mean_ospa"] == simulated.mean_ospa
    assert max(result["hole_area"], result["overlap_area"]) <= 1e-6
    assert result["kills"] == []


@pytest.mark.slow
def test_a_live_swarm_that_searches_and_tracks_follows_the_simulation_to_the_last_bit(covey: Covey) -> None:
    words = ("--team", "A2,B2", "--seconds", "10", "--seed", "3", "--control", "search-and-track", *PATIENT)
    result = covey.result("up", "quick", "--lockstep", *words)
    options = {"team.composition": "A2,B2", "run.seconds": 10.0, "run.seed": 3, "control.mode": "search-and-track"}
    assert result["transcript"] == Simulation(resolve("quick", options)).run().transcript


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize(("recorded", "seconds"), [("students03", 6.0), ("solent", 60.0)])
def test_live_swarms_over_recorded_people_and_ships_follow_the_simulation_to_the_last_bit(
    covey: Covey, recorded: str, seconds: float
) -> None:
    """A tick of the ships lasts 5 s."""
    result = covey.result("up", recorded, "--lockstep", "--seconds", str(seconds), "--seed", "3", *PATIENT)
    assert result["transcript"] == Simulation(resolve(recorded, {"run.seconds": seconds, "run.seed": 3})).run().transcript


@pytest.mark.slow
@pytest.mark.nightly
def test_a_live_swarm_of_gaussian_mixtures_follows_the_simulation_to_the_last_bit(covey: Covey) -> None:
    words = ("--team", "A2,B2", "--seconds", "10", "--seed", "3", "--set", "filter.kind=gaussian-mixture", *PATIENT)
    result = covey.result("up", "quick", "--lockstep", *words)
    options = {"team.composition": "A2,B2", "run.seconds": 10.0, "run.seed": 3, "filter.kind": "gaussian-mixture"}
    assert result["transcript"] == Simulation(resolve("quick", options)).run().transcript


@pytest.mark.slow
@pytest.mark.nightly
def test_the_cells_of_the_rest_cover_the_arena_again_after_one_and_after_five_deaths(covey: Covey) -> None:
    words = ("--seconds", "30", "--kill", "1@4", "--kill", "5@8", *PATIENT)
    result = covey.result("up", "convergence", "--lockstep", *words)
    kills = result["kills"]
    assert len(kills) == 6
    for kill, ordered in zip(kills, [16, 32, 32, 32, 32, 32]):  # tick of the order; how long it takes to be obeyed is the machine's affair
        assert ordered <= kill["tick"] < 110
        assert kill["closed_ticks"] is not None and kill["closed_ticks"] <= 3
    assert result["ticks"] == 120
    logs = Path(covey.folder / "runs" / "latest" / "logs").glob("s*.jsonl")
    assert not any('"level": "error"' in log.read_text() for log in logs)


@pytest.mark.slow
@pytest.mark.nightly
def test_in_real_time_a_dead_body_stands_still_and_a_restarted_agent_finds_it_there(covey: Covey) -> None:
    covey.start("up", "quick", "--seconds", "100000", "--rate", "4")
    covey.running()
    assert covey.run("kill", "s4")[0] == 0
    first = rows(covey.wait(lambda data: not rows(data)["s4"]["alive"]))["s4"]
    tick = first["tick"]
    dead = covey.wait(lambda data: data["swarm"]["tick"] > tick + 12 and data["swarm"]["hole"] <= 1e-6)
    there = rows(dead)["s4"]["pose"]
    assert rows(covey.wait(lambda data: data["swarm"]["tick"] > dead["swarm"]["tick"] + 4))["s4"]["pose"] == there
    assert covey.run("restart", "s4")[0] == 0
    back = covey.wait(lambda data: rows(data)["s4"]["alive"] and rows(data)["s4"]["tick"] > tick)
    moved = [abs(now - then) for now, then in zip(rows(back)["s4"]["pose"][:2], there[:2])]
    assert max(moved) <= 2.0 * (back["swarm"]["time"] - dead["swarm"]["time"] + 2.0)  # the pose is newer than the scored time
    assert rows(back)["s4"]["incarnation"] == 2
    assert covey.run("down")[0] == 0
    covey.wait_until_gone()


@pytest.mark.slow
def test_garbage_on_every_key_changes_nothing_but_a_counter(covey: Covey) -> None:
    supervisor = covey.start("up", "quick", "--run", "covey", "--lockstep", "--json", "--seconds", "30", *PATIENT)

    async def vandal() -> int:
        config = covey.folder / "runs" / "latest" / "run.toml"
        while not config.is_file() or not config.read_text():
            await asyncio.sleep(0.02)
        seeds = tuple(tomllib.loads(config.read_text())["network"]["seeds"])
        session = await asyncio.to_thread(live.open_session, NetworkSettings(seeds=seeds))
        kinds = ("hello", "beacon", "gossip", "observation", "pose", "command", "estimate")
        names = ("world", "s1", "s2", "s3", "s4", "s5", "s6")
        targets = [keys.one_of("covey", kind, name).replace("*", "0") for kind in kinds for name in names]
        thrown = 0
        while supervisor.poll() is None:
            for key in [*targets, keys.all_of("covey", "truth")]:
                session.put(key, os.urandom(1 + thrown % 300))
                thrown += 1
            await asyncio.sleep(0.05)
        await asyncio.to_thread(session.close)
        return thrown

    thrown = asyncio.run(vandal())
    assert supervisor.stdout is not None
    result = json.loads(supervisor.stdout.read().splitlines()[-1])
    simulated = Simulation(resolve("quick", {"run.seconds": 30.0})).run()
    assert thrown > 100
    assert result["transcript"] == simulated.transcript
    logs = list((covey.folder / "runs" / "latest" / "logs").glob("s*.jsonl"))
    assert any('"rejected"' in log.read_text() for log in logs)


@pytest.mark.slow
@pytest.mark.alone
def test_forty_eight_agents_start_and_close_their_first_round(covey: Covey) -> None:
    result = covey.result("up", "efficacy", "--team", "5", "--lockstep", "--seconds", "1", *PATIENT)
    assert result["agents"] == 48
    assert result["rounds"] >= 48
