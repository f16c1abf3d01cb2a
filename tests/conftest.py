"""What all tests share: one hypothesis profile, without time limits because two busy cores make them lie, and a small heap to search."""

import gc

from hypothesis import HealthCheck, settings

# print_blob: a failing property prints the line that replays it.
settings.register_profile(
    "covey", deadline=None, max_examples=100, print_blob=True, suppress_health_check=[HealthCheck.too_slow], database=None
)
settings.load_profile("covey")
gc.disable()  # while thousands of tests are collected, none of which is garbage


def pytest_collection_finish() -> None:
    """Let the collector of garbage look from now on, and never at the collected tests: that took a tenth of the time of the suite."""
    gc.freeze()
    gc.enable()
