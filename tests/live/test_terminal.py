"""`watch` on a real terminal: keys reach the swarm, and the terminal is as it was however it ends."""

import os
import pty
import select
import signal
import termios
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.live.harness import BOUND, Covey, rows

pytestmark = pytest.mark.live
FEW = ("up", "quick", "--team", "A3", "--seconds", "100000", "--rate", "4")


class Watch:
    """`covey watch` on a terminal of its own."""

    def __init__(self, covey: Covey) -> None:
        self.text = ""
        self.master, self._slave = pty.openpty()
        self.before = termios.tcgetattr(self._slave)
        self.process = covey.start("watch", terminal=self._slave)

    def until(self, condition: Callable[[], bool]) -> None:
        """Read what is shown until the condition holds."""
        end = time.monotonic() + BOUND
        while not condition():
            assert time.monotonic() < end, self.text[-2000:]
            if select.select([self.master], [], [], 0.05)[0]:
                self.text += os.read(self.master, 65536).decode(errors="replace")

    def has_keys(self) -> bool:
        """Whether single keys are read."""
        return not termios.tcgetattr(self._slave)[3] & termios.ICANON

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def ended(self) -> int:
        """The exit code, once it has ended; the terminal is as it was, with its cursor."""
        self.until(lambda: self.process.poll() is not None)
        while select.select([self.master], [], [], 0.05)[0]:
            self.text += os.read(self.master, 65536).decode(errors="replace")
        assert termios.tcgetattr(self._slave) == self.before
        assert self.text.rfind("\x1b[?25h") > self.text.rfind("\x1b[?25l"), "the cursor is hidden"
        assert "Traceback" not in self.text
        return self.process.returncode


@pytest.mark.slow
def test_keys_act_on_the_chosen_process_and_however_watch_ends_the_terminal_is_as_it_was(covey: Covey) -> None:
    covey.start(*FEW)
    covey.running()
    watch = Watch(covey)
    watch.until(watch.has_keys)
    watch.press("\x1b[B\x1b[Bk")
    watch.until(lambda: rows(covey.status() or {"processes": []}).get("s1", {}).get("state") == "dead")
    watch.press("\x1b[Bp")
    watch.until(lambda: rows(covey.status() or {"processes": []}).get("s2", {}).get("state") == "paused")
    watch.press("q")
    assert watch.ended() == 0
    for how, code in (("\x03", 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)):
        watch = Watch(covey)
        watch.until(watch.has_keys)
        watch.press(how) if isinstance(how, str) else watch.process.send_signal(how)
        assert watch.ended() == code
    watch = Watch(covey)
    watch.until(watch.has_keys)
    assert covey.run("down")[0] == 0
    assert watch.ended() == 0 and "the run has ended" in watch.text


@pytest.mark.slow
def test_ctrl_z_gives_the_terminal_back_and_takes_it_again(covey: Covey) -> None:
    covey.start(*FEW)
    covey.running()
    watch = Watch(covey)
    watch.until(watch.has_keys)
    watch.process.send_signal(signal.SIGTSTP)  # a session without a shell ignores the key's own signal, not this handler
    watch.until(lambda: not watch.has_keys())
    watch.until(lambda: Path(f"/proc/{watch.process.pid}/stat").read_text().split()[2] == "T")
    watch.process.send_signal(signal.SIGCONT)
    watch.until(watch.has_keys)
    watch.press("q")
    assert watch.ended() == 0
