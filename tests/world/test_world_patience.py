"""How long a world in lockstep waits for a command that does not come."""

import pytest

from tests.world.stage import config, started


@pytest.mark.parametrize("patience", [0.75, 5.0])
def test_the_world_waits_for_a_missing_command_as_long_as_the_setting_says(patience: float) -> None:
    world, _ = started(config(patience=patience), now=100.0)
    assert world.started and world.deadline() == 100.0 + patience


def test_a_pause_between_ticks_that_is_longer_than_the_patience_is_kept() -> None:
    world, _ = started(config(patience=0.75, max_rate=0.25), now=100.0)  # 0.5 s of the world in 2 s
    assert world.deadline() == 102.0
