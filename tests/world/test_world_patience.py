"""How long a world in lockstep waits for a command that does not come."""

import pytest

from tests.world.stage import config, started


@pytest.mark.parametrize("patience", [0.75, 5.0])
def test_the_world_waits_for_a_missing_command_as_long_as_the_setting_says(patience: float) -> None:
    world, _ = started(config(patience=patience), now=100.0)
    assert world.started and world.deadline() == 100.0 + patience
