"""Processes that hear their neighbours only: tiles, tokens one by one and chosen gossips over real Zenoh, and a death among them."""

import pytest

from tests.live.harness import Covey, rows

pytestmark = [pytest.mark.live, pytest.mark.slow]
ARENA = ("--set", "arena.width=70", "--set", "arena.height=70", "--set", "timing.interest=neighbours")


@pytest.mark.nightly
def test_their_cells_tile_the_arena_and_close_again_over_the_dead(covey: Covey) -> None:
    covey.start("up", "efficacy", "--team", "A8,C8", "--lockstep", "--seconds", "100000", *ARENA)
    covey.running()
    whole = covey.wait(lambda data: data["swarm"]["tick"] > 8 and max(data["swarm"]["hole"], data["swarm"]["overlap"]) <= 1e-6)
    assert len(rows(whole)) >= 16
    assert covey.run("kill", "s5")[0] == 0
    dead = covey.wait(lambda data: not rows(data)["s5"]["alive"])
    tick = dead["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > tick + 3 and max(data["swarm"]["hole"], data["swarm"]["overlap"]) <= 1e-6)
    assert covey.run("restart", "s5")[0] == 0
    covey.wait(lambda data: rows(data)["s5"]["alive"] and rows(data)["s5"]["cell"] > 0.0 and data["swarm"]["hole"] <= 1e-6)
    assert covey.run("down")[0] == 0
    covey.wait_until_gone()
