"""A real browser for the benchmarks: Chromium without a window, its CPU time, and when it drew which frame of the page."""

import itertools
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from deploy.bench.processes import cpu_of
from protocol.settings import BadSetting

NAMES = ("chromium", "chromium-browser", "google-chrome")
SIZE = (1440, 900)
WORDS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--remote-debugging-port=0",
    f"--window-size={SIZE[0]},{SIZE[1]}",
)
START_SECONDS = 180.0
WATCH = """() => {
  const drawn = window.drawn = [];
  let last = -1;
  const look = (now) => {
    if (covey.frame && covey.frames !== last) drawn.push([now, covey.frame.time]);
    last = covey.frames;
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}"""


class Browser:
    """Chromium with one page open."""

    def __init__(self, process: "subprocess.Popen[str]", window: Any) -> None:
        self._process, self._window = process, window

    def cpu(self) -> float:
        """CPU time of all its processes so far, s."""
        return sum(cpu_of(pid) for pid in [self._process.pid, *descendants(self._process.pid)])

    def ask(self, expression: str) -> Any:
        """What an expression gives in the page."""
        return self._window.evaluate(expression)

    def until(self, expression: str) -> None:
        """Wait until an expression holds in the page."""
        end = time.monotonic() + START_SECONDS
        while not self.ask(f"Boolean({expression})"):
            if time.monotonic() > end:
                raise BadSetting(f"bench: the page has not come to this: {expression}")
            time.sleep(0.1)

    def watch(self) -> None:
        """From now on note when a new frame is drawn."""
        self.ask(WATCH)

    def drawn(self) -> list[tuple[float, float]]:
        """(wall ms, the world's time s) of every frame that was drawn since `watch`."""
        return [(wall, world) for wall, world in self.ask("window.drawn")]


@contextmanager
def browser(url: str) -> Iterator[Browser]:
    """Chromium with a page open. As root it would raise its own priority, so it runs as the user nobody then."""
    from playwright.sync_api import sync_playwright  # of the extra `test`

    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        raise BadSetting("bench page: needs Chromium; apt-get install chromium")
    humble = {"user": "nobody", "group": "nogroup"} if os.geteuid() == 0 else {}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        os.chmod(folder, 0o777)
        process = subprocess.Popen(
            [program, *WORDS, f"--user-data-dir={folder}", "about:blank"],
            env={**os.environ, "HOME": folder},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            user=humble.get("user"),
            group=humble.get("group"),
        )
        try:
            with sync_playwright() as driver:
                window = driver.chromium.connect_over_cdp(_endpoint(process)).contexts[0].pages[0]
                window.goto(url)
                yield Browser(process, window)
        finally:
            process.kill()
            process.communicate()


def _endpoint(process: "subprocess.Popen[str]") -> str:
    """The DevTools endpoint that it prints."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("DevTools listening on "):
            return line.split()[-1]
    raise BadSetting("bench page: Chromium does not start")


def descendants(pid: int) -> list[int]:
    """The children of a process, their children, and so on."""
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        children.setdefault(parent(int(folder.name)), []).append(int(folder.name))
    found = children.get(pid, [])
    return [*found, *itertools.chain.from_iterable(map(descendants, found))] if found else []


def parent(pid: int) -> int:
    """The process that a process is a child of; 0 when it has gone."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rsplit(")", 1)[1].split()[1])
    except OSError:
        return 0
