"""A real Chromium for the tests of the page: a window, waiting for what it shows, and the marks of such tests."""

import shutil
import time
from collections.abc import Iterator
from typing import Any

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright")
CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
WORDS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]
PATIENCE = 120_000.0  # ms; reached only when something hangs
MARKS = [
    pytest.mark.live,
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.timeout(400),
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine: apt-get install chromium"),
]


@pytest.fixture
def page(request: pytest.FixtureRequest) -> Iterator[Any]:
    """A window; at the end no page may have raised an error, and its console holds the complaint that a test expects, and no other."""
    complaints: list[str] = []
    expected = getattr(request, "param", None)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=WORDS, timeout=2.0 * PATIENCE)
        window = browser.new_page(viewport={"width": 1400, "height": 900})
        window.set_default_timeout(PATIENCE)
        window.on("console", lambda message: complaints.append(message.text) if message.type in ("error", "warning") else None)
        window.on("pageerror", lambda error: complaints.append(str(error)))
        yield window
        browser.close()
    others = [one for one in complaints if expected is None or expected not in one]
    assert not others, others
    assert expected is None or complaints, f"nobody complained of {expected}"


def address(process: Any) -> str:
    """The page's address, which is the first thing that a command says."""
    line = process.stdout.readline()
    assert line.startswith("page: http://127.0.0.1:"), line
    return str(line.split()[1])


def until(page: Any, expression: str) -> None:
    """Wait until an expression holds in the page; by asking again and again, for the page forbids itself to evaluate texts."""
    end = time.monotonic() + PATIENCE / 1000.0
    while not page.evaluate(f"Boolean({expression})"):
        assert time.monotonic() < end, f"never: {expression}; the page says {page.inner_text('body')[-2000:]!r}"
        page.wait_for_timeout(50)


def happened(kind: str, who: str) -> str:
    """Whether something stands on the time line, as an expression."""
    return f"[...covey.happenings.values()].some(([, , kind, who]) => kind === '{kind}' && who === '{who}')"


def alive(page: Any, url: str) -> None:
    """Open the page and wait until it shows a tick."""
    page.goto(url)
    until(page, "covey.frame && covey.frame.tick >= 2")


def bottom(selector: str) -> str:
    """Where an element ends, px from the top of the window, as an expression."""
    return f"document.querySelector('{selector}').getBoundingClientRect().bottom"
