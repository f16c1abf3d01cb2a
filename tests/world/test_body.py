"""A body of its own: whose commands it obeys and for how long, the ticks that it opens, and its session."""

import msgspec
import pytest

from deploy.scenario import resolve, world_config
from protocol.messages import Command, Gossip, Hello
from protocol.node import Alive, Gone, Reopen, Started, Stop, Timer, received
from protocol.settings import BadSetting
from tests.world.robot import Robot, command, config, started
from world.body import EXIT_INCOMPLETE, Body, check_epoch


def test_a_body_with_half_a_session_opens_it_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """It hears its agent and sees no token, so it would stand for ever."""
    body = started(monkeypatch)
    body.handle(Gone("agent", "s1", 1), 0.0)
    effects = [effect for now in (1.0, 3.0, 5.0, 7.0) for effect in body.handle(received(Hello(sender="s1", incarnation=1)), now)]
    assert [effect for effect in effects if isinstance(effect, Reopen)] == [Reopen("s1 speaks, but its token has gone")]


def test_a_body_that_waits_for_its_agent_looks_four_times_a_second() -> None:
    body = Body(config(), "s1", 1)
    body.handle(Started(), 0.0)
    looks = []
    while len(looks) < 4:
        due = body.deadline()
        assert due is not None
        looks.append(due)
        assert body.handle(Timer(), due) == []
    assert looks == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.parametrize(("strict", "codes", "tick"), [(False, [], 0), (True, [EXIT_INCOMPLETE], -1)])
def test_a_body_that_waits_in_vain_for_an_agent_begins_without_it_or_ends_a_strict_run(strict: bool, codes: list[int], tick: int) -> None:
    body = Body(config(**{"run.strict": strict, "run.start_timeout": 5.0}), "s1", 1)
    for event in (Started(), Alive("agent", "s1", 1)):
        body.handle(event, 0.0)
    effects = body.handle(Timer(), 5.0)
    assert [effect.code for effect in effects if isinstance(effect, Stop)] == codes and body.tick == tick


def test_without_a_command_for_half_a_second_it_is_stopped_once(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.1)
    assert Robot.told == [((1.0, 0.0), 0.5)]
    for now in (0.25, 0.5, 0.59):
        body.handle(Timer(), now)
    assert Robot.told == [((1.0, 0.0), 0.5)]
    assert body.deadline() == pytest.approx(0.6)
    body.handle(Timer(), 0.6)
    body.handle(Timer(), 0.75)
    assert Robot.told[1:] == ["stop"]
    body.handle(command(3), 0.8)
    assert Robot.told[2:] == [((1.0, 0.0), 0.5)]


def test_a_late_command_drives_a_body_with_a_size_for_two_ticks_from_its_own_and_no_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch, **{"limits.radius": 0.25})
    for now in (0.0, 0.25):
        body.handle(Timer(), now)
    body.handle(command(0), 0.4)
    assert Robot.told == [((1.0, 0.0), 0.5)]
    body.handle(Timer(), 0.5)
    assert Robot.told[1:] == ["stop"], "who asked knew no places of later ticks"
    body.handle(command(1), 0.8)
    assert Robot.told[2:] == [], "its time is over"


def test_in_a_paced_lockstep_a_command_holds_for_the_whole_of_a_long_tick() -> None:
    settings = {
        "team.composition": "A1",
        "bodies.host": "own",
        "run.clock": "lockstep",
        "run.max_rate": 0.25,
        "run.dt": 0.25,
        "targets.count": 1,
    }
    body, now = Body(world_config(resolve("efficacy", settings)), "s1", 1), 0.0
    body.handle(Started(), now)
    body.handle(Alive("agent", "s1", 1), now)
    hello = Hello(sender="s1", incarnation=1, role="agent", software="", sensor_class="A", heard=())
    body.handle(received(hello), now)
    while body.tick < 0:
        now += 0.25
        body.handle(Timer(), now)
    start, tick, now = body.pose, body.tick, now + 0.1
    body.handle(received(Command(sender="s1", incarnation=1, tick=tick, velocity=(1.0, 0.0), turn_rate=0.0)), now)
    while body.tick == tick:
        due = body.deadline()
        assert due is not None
        now = max(now, due)
        body.handle(Timer(), now)
    assert body.pose[0] - start[0] == pytest.approx(0.25)


def test_a_command_of_another_life_of_the_agent_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    body.handle(Timer(), 0.0)
    body.handle(command(0, incarnation=2), 0.1)
    body.handle(command(1), 0.1)
    assert Robot.told == [] and body.ignored_commands == 2


def test_a_younger_agent_does_not_drive_on_by_the_command_of_the_older_one(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.1)
    body.handle(Alive("agent", "s1", 2), 0.15)
    assert Robot.told[1:] == ["stop"]
    body.handle(Gone("agent", "s1", 1), 0.2)
    body.handle(command(0, incarnation=2), 0.2)
    assert Robot.told[-1] != "stop", "the younger one drives it"


def test_no_gossip_of_a_tick_after_the_last_one_ends_a_body(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch, **{"run.seconds": 5.0})
    for event in (Alive("agent", "s2", 1), Alive("body", "s2", 1), Timer()):
        body.handle(event, 0.0)
    wrong = Gossip(sender="s2", incarnation=1, tick=20, pose=(1.0, 1.0, 0.0), cod=(1.0, 1.0), power_radius=0.0, unused=0.0)
    assert body.handle(received(wrong), 0.1) == [] and body.tick == 0
    body.handle(received(msgspec.structs.replace(wrong, tick=19)), 0.1)
    assert body.tick == 19


def test_gossips_that_have_waited_while_a_platform_took_its_time_do_not_set_the_clock_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """After 7 s the gossips of these 7 s are there at once; one that comes in time sets it on."""
    body = started(monkeypatch)
    for event in (*(Alive(role, name, 1) for role in ("agent", "body") for name in ("s2", "s3")), Timer()):
        body.handle(event, 0.0)

    def hear(tick: int, now: float) -> None:
        for name in ("s2", "s3"):
            said = Gossip(sender=name, incarnation=1, tick=tick, pose=(1.0, 1.0, 0.0), cod=(1.0, 1.0), power_radius=0.0, unused=0.0)
            body.handle(received(said), now)

    hear(1, 7.0)
    body.handle(Timer(), 7.0)
    assert body.tick == 28
    hear(15, 7.0)
    assert body.tick == 28 and body.counts()["clock_corrections"] == 0
    for now in (7.25, 7.5, 7.75):
        body.handle(Timer(), now)
    hear(60, 7.76)
    assert body.tick == 60


def test_a_tick_that_is_left_out_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.1)
    body.handle(Timer(), 0.55)  # tick 1 never began
    assert Robot.told[1:] == ["stop"] and body.tick == 2


def test_the_last_tick_stops_the_platform(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch, **{"run.seconds": 0.25})
    body.handle(Timer(), 0.0)
    assert body.handle(Timer(), 0.25) == [Stop(0, "done")] and Robot.told == ["stop"]


def test_an_epoch_that_lies_too_far_ahead_is_refused() -> None:
    settings = config(**{"bodies.epoch": 1000.0, "run.clock": "realtime"})
    check_epoch(settings, 941.0)
    with pytest.raises(BadSetting, match=r"bodies.epoch = 1000.000: lies 100 s ahead of this machine's clock; should be at most 60 s"):
        check_epoch(settings, 900.0)


def test_an_epoch_whose_run_is_over_is_refused() -> None:
    settings = config(**{"bodies.epoch": 1000.0, "run.clock": "realtime", "run.rate": 2.0, "run.seconds": 60.0})
    check_epoch(settings, 1029.0)
    over = r"bodies.epoch = 1000.000: by this machine's clock the run of 30 s ended 70 s ago; should be 0, or more than 1070: is"
    with pytest.raises(BadSetting, match=over):
        check_epoch(settings, 1100.0)


def test_a_late_loss_of_an_old_body_takes_its_successor_not_out_of_the_ring_of_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    for event in (Alive("agent", "s2", 1), Alive("body", "s2", 1), Alive("body", "s2", 2), Gone("body", "s2", 1)):
        body.handle(event, 0.1)
    assert body._ring == ("s2",)
    body.handle(Gone("body", "s2", 2), 0.2)
    assert body._ring == ()


def test_a_body_in_lockstep_keeps_a_pause_that_is_longer_than_its_patience() -> None:
    paced = {"run.clock": "lockstep", "run.max_rate": 0.1, "run.patience": 0.5, "run.start_timeout": 1.0}
    body = Body(config("simulated", **paced), "s1", 1)
    for event in (Started(), Alive("agent", "s1", 1), received(Hello(sender="s1", incarnation=1))):
        body.handle(event, 100.0)
    body.handle(Timer(), 102.0)
    body.handle(Timer(), 102.5)
    assert body.tick == 1 and body._waiting
    assert body.deadline() == 102.0 + body._pause == 104.5
