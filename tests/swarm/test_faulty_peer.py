"""One agent of seven that says wrong things in valid messages: the others go on, and what cannot be is not heard."""

import pytest

from agents.membership.peer_table import MOST_STRANGERS
from tests.swarm.faulty_peer import (
    Lie,
    claim_of_everything,
    made_up_names,
    mass_without_end,
    play,
    silence,
    ticks_far_ahead,
    wrong_ticks_beside_the_right_one,
)


@pytest.mark.parametrize("lie", [claim_of_everything, mass_without_end, ticks_far_ahead])
def test_who_says_what_cannot_be_is_not_heard_and_costs_no_more_than_its_death(lie: Lie) -> None:
    found, dead = play(lie), play(silence)
    assert found.result.steady_ospa == pytest.approx(dead.result.steady_ospa, abs=0.3)
    assert found.agent.counters["late"] == dead.agent.counters["late"] == 4, "nobody waits for it after four rounds"


@pytest.mark.parametrize("lie", [wrong_ticks_beside_the_right_one, made_up_names])
def test_what_is_said_beside_right_gossips_changes_no_bit(lie: Lie) -> None:
    found, honest = play(lie), play(None)
    for part in ("mean_ospa", "final_ospa", "hole_area", "overlap_area", "mass_residual"):
        assert getattr(found.result, part) == getattr(honest.result, part)
    assert found.agent.counters["missing"] == 0
    assert not [name for name in found.agent.counters if name.startswith("rejected.")], "all of it is heard"
    assert len(found.agent.peer_table.peers) == 6 + MOST_STRANGERS * (lie is made_up_names)
