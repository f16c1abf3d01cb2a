"""How many deaths of a run are kept."""

import numpy as np

from deploy.scoring.deaths import MOST_DEATHS, Deaths


def test_one_that_comes_and_goes_all_the_time_fills_no_memory_and_the_first_deaths_stay() -> None:
    deaths = Deaths()
    for tick in range(MOST_DEATHS + 100):
        deaths.lose("guest", tick, 0.25 * tick, 0.25 * tick, np.empty((0, 2)))
    assert [kill.tick for kill in deaths.kills()] == [*range(MOST_DEATHS)]
    deaths.regain("guest", 0.0)
    deaths.lose("s1", 9, 2.25, 2.25, np.empty((0, 2)))
    assert [kill.name for kill in deaths.kills()][-1] == "s1"
