"""The page in a real Chromium: it comes alive, a click kills, a replay is scrubbed; the browser has nothing to complain of."""

import json
import time
from pathlib import Path
from typing import Any

import pytest

from deploy.recording.recording import Recording, event_of
from protocol.node import messages_of
from protocol.observer_messages import Estimate, Truth
from tests.live.browser import MARKS, address, alive, bottom, happened, page, until
from tests.live.harness import ROOT, Covey, rows

__all__ = ["page"]  # a fixture
pytestmark = MARKS
LONG = ("up", "quick", "--seconds", "1000", "--rate", "2", "--page", "0", "--set", "network.link_faults=true")
KILL_SECONDS = 2.0  # from the click until the body is grey, its cell taken over, and the time line says so
ALIVE_SECONDS = 5.0  # from the address of the demo until the page is alive
BUSY = 5.0  # times the limits that the page promises: other tests run beside this one; docs/how-to/watch.md has what a quiet machine takes


TITLES = """window.titles = [];
const fill = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
  if (this.canvas.closest('#charts')) window.titles.push(text);
  return fill.call(this, text, ...place);
};
null"""  # what is written on the curves; the title of one after the names of its lines
SLOW = """
import sys, time
if "deploy.live.zygote" in sys.orig_argv:
    time.sleep(20.0)
"""


def test_bodies_move_and_a_click_kills(covey: Covey, page: Any) -> None:
    process = covey.start(*LONG, "--record")
    alive(page, address(process))
    covey.running()
    places = page.evaluate("JSON.stringify(covey.frame.agents.map((agent) => agent.pose))")
    until(page, f"JSON.stringify(covey.frame.agents.map((agent) => agent.pose)) !== {json.dumps(places)}")

    page.click("#row-s2 button")
    until(page, "covey.belief && covey.belief.name === 's2' && covey.belief.claim.length > 0")
    until(page, "covey.frame.score && covey.frame.score[6] < 1e-6")
    until(page, "document.querySelector('#legend').textContent.includes('its claim')")
    clicked = time.monotonic()
    page.click("#belief [data-verb=kill]")
    until(page, f"document.querySelector('#row-s2.dead') && {happened('lost', 's2')}")
    until(page, "covey.frame.agents.find((agent) => agent.name === 's2').cell.length === 0 && covey.frame.score[6] < 1e-6")
    until(page, "document.querySelector('#log').textContent.includes('s2 is gone')")
    until(page, "document.querySelector('#belief-cell').textContent.startsWith('Held')")
    until(page, "!document.querySelector('#legend').textContent.includes('its claim')")  # nothing of a dead one's belief is drawn
    taken = time.monotonic() - clicked
    print(f"from the click to the cell taken over: {taken:.2f} s")  # shown by pytest -s
    assert taken < KILL_SECONDS * BUSY
    assert rows(covey.wait(lambda data: rows(data)["s2"]["state"] == "dead"))["s2"]["end"] == "killed by SIGKILL"

    page.click("#belief [data-verb=restart]")
    until(page, "covey.frame.agents.find((agent) => agent.name === 's2').state === 'alive'")
    page.click("#belief [data-verb=pause]")
    page.wait_for_selector("#row-s2.paused")
    page.click("#belief [data-verb=resume]")
    page.wait_for_selector("#row-s2.alive")


def test_an_agent_is_cut_off_and_the_links_are_healed_by_click(covey: Covey, page: Any) -> None:
    process = covey.start(*LONG)
    alive(page, address(process))
    covey.running()
    page.click("#row-s5 button")
    page.click("#belief [data-verb=partition]")
    until(page, f"{happened('partition', '')} && document.querySelector('#log').textContent.includes('cut off s5')")
    until(page, "covey.frame.score && covey.frame.score[7] > 0.01")  # both sides own the ground of the other
    page.click("#belief [data-verb=heal]")
    until(page, happened("heal", ""))
    until(page, "covey.frame.score[7] < 1e-6")


@pytest.mark.alone  # where cores are starved the swarm beside falls behind, and its title says so
def test_the_page_of_the_demo_is_the_first_thing_said_and_is_alive_soon(covey: Covey, page: Any) -> None:
    """In real time: 200 s in 80 s are more than two cores can do that draw the page as well."""
    url = address(covey.start("demo", "--page", "0", "--seconds", "80"))
    said = time.monotonic()
    page.goto(url)
    until(page, "document.querySelector('#link').textContent === 'live' && document.querySelectorAll('#roster tbody tr').length === 16")
    taken = time.monotonic() - said
    print(f"from the address to the page that is alive: {taken:.2f} s")
    assert taken < ALIVE_SECONDS * BUSY
    until(page, "covey.frame && covey.frame.tick > 4 && covey.frame.agents.every((agent) => agent.state === 'alive')")
    of_one_tick = "covey.frame.tick === covey.frame.beside.tick && covey.frame.targets.join() === covey.frame.beside.targets.join()"
    until(page, f"covey.frame.beside && covey.frame.beside.score && {of_one_tick}")
    assert page.evaluate("covey.hello.beside.names") == ["the paper's method, live", "search and track, simulated"]
    page.set_viewport_size({"width": 1280, "height": 720})
    page.evaluate(TITLES)
    until(page, "titles.some((text, at) => /^search and track.*[0-9]$/.test(text) && titles[at + 2] === 'OSPA')")
    page.set_viewport_size({"width": 1440, "height": 900})
    until(page, f"{bottom('#row-s16')} <= {bottom('#team')}")  # the last row is seen whole
    page.set_viewport_size({"width": 420, "height": 900})
    until(page, "document.querySelector('#title').scrollWidth <= document.querySelector('#title').clientWidth")
    until(page, "document.documentElement.scrollWidth <= 420")
    until(page, "document.querySelector('#arena').offsetHeight === document.querySelector('#beside').offsetHeight")


def test_everything_can_be_reached_by_keyboard(covey: Covey, page: Any) -> None:
    alive(page, address(covey.start(*LONG)))
    covey.running()
    page.keyboard.press("ArrowRight")
    until(page, "covey.chosen === 's1' && covey.belief")
    page.keyboard.press("ArrowLeft")
    until(page, "covey.chosen === 's6'")
    page.keyboard.press("Escape")
    assert page.evaluate("covey.chosen") is None
    page.keyboard.press("t")
    assert page.get_attribute("#switch-truth", "aria-pressed") == "false"
    theme = page.evaluate("document.documentElement.dataset.theme")
    page.keyboard.press("x")
    assert page.evaluate("document.documentElement.dataset.theme") != theme
    page.keyboard.press("?")
    assert page.is_visible("#help")
    page.keyboard.press("Escape")
    for _ in range(100):  # Tab leads to the roster, Enter chooses
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.closest('tbody') !== null"):
            break
    page.keyboard.press("Enter")
    until(page, "covey.chosen === 's1'")


def test_what_the_page_shows_is_what_was_recorded(covey: Covey, page: Any) -> None:
    """At mid-run: targets, estimates and cells of one tick, against the recording of the same run; in lockstep, so that nothing is late."""
    process = covey.start("up", "quick", "--lockstep", "--seconds", "10000", "--page", "0", "--record")
    alive(page, address(process))
    covey.running()
    until(page, "covey.frame.tick >= 20 && covey.frame.score")
    shown = page.evaluate("({tick: covey.frame.tick, targets: covey.frame.targets, agents: covey.frame.agents})")
    page.goto("about:blank")  # a page that is open would complain that its server has gone
    assert covey.run("down")[0] == 0
    process.wait(timeout=60)
    events = map(event_of, Recording(covey.folder / "runs" / "latest" / "recording.mcap").entries())
    messages = [message for event in events for message in messages_of(event)]
    truth = next(message for message in messages if isinstance(message, Truth) and message.tick == shown["tick"])
    assert shown["targets"] == pytest.approx(truth.targets.ravel(), abs=0.006)
    drawn = {agent["name"]: agent for agent in shown["agents"]}
    estimates = [message for message in messages if isinstance(message, Estimate) and message.tick == shown["tick"]]
    assert len(estimates) > 0
    for estimate in estimates:
        assert drawn[estimate.sender]["cell"] == pytest.approx(estimate.cell.ravel(), abs=0.006)
        assert drawn[estimate.sender]["targets"] == pytest.approx(estimate.targets.ravel(), abs=0.006)


def test_a_replay_plays_pauses_is_scrubbed_and_changes_its_speed(covey: Covey, page: Any, tmp_path: Path) -> None:
    file = tmp_path / "some.mcap"
    assert covey.run("simulate", "quick", "--kill", "s3@10", "--record", str(file))[0] == 0
    process = covey.start("replay", str(file), "--page", "0", "--speed", "4")
    alive(page, address(process))
    until(page, "document.querySelector('#speed').value === '4'")
    page.keyboard.press(">")
    until(page, "covey.frame.play.speed === 5 && document.querySelector('#speed').value === '5'")
    until(page, "covey.frame.play.scanned && covey.history.time.length >= 118")
    assert page.evaluate("[...covey.happenings.values()].some(([, time, kind, who]) => kind === 'lost' && who === 's3' && time >= 10)")
    page.select_option("#speed", "10")
    until(page, "covey.frame.time > 12 || !covey.frame.play.playing")
    until(page, "covey.frame.agents[2].state === 'dead'")
    until(page, "!covey.frame.play.playing")  # at the end
    page.fill("#scrub", "5")
    until(page, "Math.abs(covey.frame.time - 5) < 0.6 && covey.frame.agents[2].state === 'alive'")
    page.select_option("#speed", "0.5")
    page.click("#play")
    until(page, "covey.frame.play.playing && covey.frame.time > 5.6")
    page.click("#play")
    until(page, "!covey.frame.play.playing")
    page.select_option("#speed", "10")
    page.fill("#scrub", "20")
    until(page, "Math.abs(covey.frame.time - 20) < 0.6 && covey.frame.agents[2].state === 'dead'")
    assert page.evaluate("covey.frame.score[0]") == pytest.approx(page.evaluate("covey.frame.time"))
    page.click("#play")
    until(page, "covey.frame.time > 21")


def test_the_page_says_what_the_start_waits_for_until_it_begins(covey: Covey, page: Any) -> None:
    (covey.folder / "sitecustomize.py").write_text(SLOW)
    process = covey.start(*LONG, variables={"PYTHONPATH": f"{covey.folder}:{ROOT}"})
    page.goto(address(process))
    waiting = "document.getElementById('waiting')"
    until(page, f"!{waiting}.hidden && {waiting}.textContent === 'loading the compiled loops'")
    assert page.evaluate("covey.frame.tick") == -1
    until(page, f"covey.frame.tick > 0 && {waiting}.hidden")
    assert covey.run("down")[0] == 0
