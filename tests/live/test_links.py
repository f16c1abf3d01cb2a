"""Bad links between real processes: cut and healed from another terminal, spoilt by a scenario, and out of reach unless it allows them."""

import statistics

import pytest

from deploy.recording.recording import Recording
from tests.live.harness import Covey, Journal, rows

pytestmark = pytest.mark.live
ALLOWED = ("--set", "network.link_faults=true")


@pytest.mark.slow
def test_a_partition_covers_the_arena_twice_and_heals_to_one_claim_per_place(covey: Covey) -> None:
    covey.start("up", "quick", "--seconds", "100000", "--rate", "2", *ALLOWED)
    covey.running()
    code, said, _ = covey.run("partition", "s1,s2,s3")
    assert (code, said) == (0, "cut off s1, s2, s3\n")
    apart = covey.wait(lambda data: data["swarm"]["overlap"] > 0.99 and data["swarm"]["hole"] <= 1e-6)
    assert covey.run("kill", "s1")[0] == 0
    last = rows(covey.wait(lambda data: not rows(data)["s1"]["alive"]))["s1"]["tick"]
    assert covey.run("restart", "s1")[0] == 0
    back = covey.wait(lambda data: rows(data)["s1"]["alive"] and rows(data)["s1"]["tick"] > last)["swarm"]["tick"]
    looks = [covey.wait(lambda data, at=back + 8 + look: data["swarm"]["tick"] >= at) for look in range(9)]  # type: ignore[misc]
    assert statistics.median(look["swarm"]["overlap"] for look in looks) > 0.99, "who comes back is cut off too"
    apart = looks[-1]
    assert covey.run("heal")[1] == "all links are clear again\n"
    tick = covey.status()["swarm"]["tick"]
    whole = covey.wait(
        lambda data: data["swarm"]["tick"] > apart["swarm"]["tick"] and data["swarm"]["overlap"] <= 1e-6 >= data["swarm"]["hole"]
    )
    print(f"one claim per place {0.25 * (whole['swarm']['tick'] - tick):.2f} s of world time after the heal")
    assert covey.run("drop", "0.3")[1].startswith("drop 30 % of the messages")
    covey.wait(lambda data: data["swarm"]["overlap"] > 1e-6)
    assert covey.run("down")[0] == 0
    covey.wait_until_gone()


@pytest.mark.slow
@pytest.mark.nightly
def test_who_hears_neighbours_only_covers_the_arena_on_each_side_of_a_cut_and_meets_again(covey: Covey) -> None:
    ground = ("--set", "arena.width=70", "--set", "arena.height=70", "--set", "timing.interest=neighbours", "--dt", "0.5")
    covey.start("up", "efficacy", "--team", "A8,C8", "--seconds", "100000", "--rate", "1", "--record", *ground, *ALLOWED)
    covey.running()
    covey.wait(lambda data: max(data["swarm"]["hole"], data["swarm"]["overlap"]) <= 1e-6)
    side = ",".join(f"s{number}" for number in range(1, 17, 2))
    assert covey.run("partition", side)[0] == 0
    covey.wait(lambda data: data["swarm"]["overlap"] > 0.99 and data["swarm"]["hole"] <= 1e-6)
    assert covey.run("heal")[0] == 0
    tick = covey.status()["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > tick + 12)
    assert covey.run("down")[0] == 0
    covey.wait_until_gone()
    heal = Recording(covey.runs / "latest" / "recording.mcap").faults[-1]
    clean = {tick for tick, score in Journal(covey).scores.items() if max(score.hole, score.overlap) <= 1e-6}
    healed = 0.5 * min(tick for tick in clean if 0.5 * tick >= heal.time) - heal.time
    print(f"one claim per place {healed:.1f} s of world time after the heal")
    assert heal.verb == "heal" and healed <= 3.0


@pytest.mark.slow
def test_link_faults_are_out_of_reach_unless_the_scenario_allows_them(covey: Covey) -> None:
    covey.start("up", "quick", "--seconds", "100000", "--rate", "2")
    covey.running()
    code, _, complaints = covey.run("partition", "s1")
    assert code == 2 and complaints == "covey: verb = 'partition': link faults need network.link_faults = true in the scenario\n"
    assert covey.run("drop", "1.5", "s1")[0] == 2
    assert covey.run("down")[0] == 0
    covey.wait_until_gone()


@pytest.mark.slow
@pytest.mark.alone  # in real time: where cores are starved all may miss a tick, which is a hole of the whole arena
def test_loss_asked_for_on_the_command_line_is_there_from_the_start(covey: Covey) -> None:
    result = covey.result("up", "quick", "--seconds", "10", "--rate", "2", "--loss", "0.3")
    assert 30 <= result["ticks"] <= 40
    assert 0.0 < result["hole_area"] < 1.0 and result["overlap_area"] > 0.0
