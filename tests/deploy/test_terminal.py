"""Single keys from a terminal: signals cannot end the program where nobody would give the terminal back."""

import asyncio
import os
import pty
import signal
import termios

import pytest

from deploy.cli.terminal import keyboard, stop_event


def test_signals_wait_until_the_first_look_for_keys_and_the_terminal_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else Ctrl-C in the first picture, while its modules are imported, ends the program without an echo in the terminal."""
    master, slave = pty.openpty()
    asking = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP}

    def blocked() -> set[signal.Signals]:
        return {number for number in signal.pthread_sigmask(signal.SIG_BLOCK, []) if number in asking}

    with os.fdopen(slave) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        before, held = termios.tcgetattr(slave), blocked()
        with keyboard(lambda shown: None) as pressed:
            assert not termios.tcgetattr(slave)[3] & termios.ICANON
            assert (held, blocked()) == (set(), asking)
            os.write(master, b"k\x1b[A")
            assert pressed(5.0) == ["k", "up"] and blocked() == set()
        assert termios.tcgetattr(slave) == before and blocked() == set()
    os.close(master)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_replay_ends_in_order_when_its_terminal_is_closed(number: signal.Signals) -> None:
    """So that the folder of what is said again is removed."""

    async def scene() -> None:
        over = stop_event()
        signal.raise_signal(number)
        await asyncio.wait_for(over.wait(), 5.0)

    before = signal.signal(number, lambda *_: None)
    asyncio.run(scene())
    signal.signal(number, before)
