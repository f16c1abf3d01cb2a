"""What an operator who says halt concludes from the poses, and how long it waits."""

from deploy.cli.halt import MOST, SETTLE, Operator, outcome
from protocol.messages import Halt, Observation
from protocol.node import Started, Stop, Timer, received


def conclusion(operator: Operator, poses: list[tuple[float, float]], until: float) -> tuple[int, float]:
    """The exit code and its time, s, of an operator who is told this: when, and how far east the body then is."""
    operator.handle(Started(), 0.0)
    due = list(poses)
    while (now := operator.deadline() or 0.0) < until:
        while due and due[0][0] <= now:
            at, east = due.pop(0)
            told = Observation(sender="world", recipient="s1", incarnation=1, tick=0, time=at, pose=(east, 0.0, 0.0))
            operator.handle(received(told), now)
        halt, *others = operator.handle(Timer(), now)
        assert isinstance(halt, Halt)
        for effect in others:
            if isinstance(effect, Stop):
                return effect.code, now
    raise AssertionError("the operator did not end")


def test_bodies_that_stand_end_the_order_and_one_that_moves_is_reported() -> None:
    standing = [(0.25 * tick, 3.0) for tick in range(40)]
    code, end = conclusion(Operator("r", 1, held=True, period=0.25), standing, 10.0)
    assert code == 0 and SETTLE <= end < SETTLE + 0.2
    moving = [(0.25 * tick, 0.5 * tick) for tick in range(40)]
    operator = Operator("r", 1, held=True, period=0.25)
    code, end = conclusion(operator, moving, 10.0)
    assert code == 1 and MOST <= end < MOST + 0.2
    assert operator.bodies - operator.standing == {"s1"}


def test_the_operator_waits_for_two_poses_however_long_a_tick_lasts() -> None:
    code, end = conclusion(Operator("r", 1, held=True, period=8.0), [(0.5, 3.0), (8.5, 3.0)], 40.0)
    assert code == 0 and 8.5 <= end < 9.0


def test_where_poses_err_the_order_is_only_said() -> None:
    scattered = [(0.25 * tick, 0.3 * (-1.0) ** tick) for tick in range(40)]
    code, end = conclusion(Operator("r", 1, held=True, period=0.25, judges=False), scattered, 10.0)
    assert code == 0 and SETTLE <= end < SETTLE + 0.2


def test_a_release_ends_well_once_a_body_is_heard_and_fails_where_none_is() -> None:
    heard = [(8.0 * tick + 3.0, 3.0) for tick in range(5)]
    code, end = conclusion(Operator("r", 1, held=False, period=8.0), heard, 40.0)
    assert code == 0 and 16.0 <= end < 16.2
    code, end = conclusion(Operator("r", 1, held=False, period=8.0), [], 40.0)
    assert code == 1 and 32.0 <= end < 32.2
    code, end = conclusion(Operator("r", 1, held=True, period=0.25, judges=False), [], 40.0)
    assert code == 1 and MOST <= end < MOST + 0.2


def test_a_release_that_moves_nobody_says_why_that_may_be() -> None:
    """Of two orders the one with the larger incarnation counts, which is the clock of the machine that gave it."""
    said = []
    for speed in (0.0, 1.0):
        operator = Operator("r", 1, held=False, period=0.25)
        conclusion(operator, [(0.25 * tick, 0.25 * tick * speed) for tick in range(40)], 10.0)
        said.append(outcome(operator, held=False, wrong=""))
    hint = "none moves yet: a halt counts on if it came from a machine whose clock is ahead of this one"
    assert said == [f"released 1 bodies; {hint}", "released 1 bodies"]
    assert outcome(operator, held=False, wrong="bodies.position_error") == "released 1 bodies"
