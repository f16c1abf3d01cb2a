"""What all tests share: one hypothesis profile, without time limits because two busy cores make them lie."""

from hypothesis import HealthCheck, settings

# print_blob: a failing property prints the line that replays it.
settings.register_profile(
    "covey", deadline=None, max_examples=100, print_blob=True, suppress_health_check=[HealthCheck.too_slow], database=None
)
settings.load_profile("covey")
