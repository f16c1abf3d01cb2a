"""The page explains itself in a real Chromium: hints, tour, zoom, keys, read-outs, links, a comparison, no barriers."""

import signal
from pathlib import Path
from typing import Any

import msgspec
import pytest
from PIL import Image

from deploy.recording.observers import Observers, open_recorder
from deploy.scenario import FaultSettings, resolve
from deploy.simulation import Simulation
from tests.live.browser import MARKS, address, alive, page, until
from tests.live.harness import Covey

__all__ = ["page"]  # a fixture
pytestmark = MARKS
SIZES = ((1440, 900), (1920, 1080), (390, 844), (844, 390))
BOX = "document.querySelector('#arena').getBoundingClientRect()"
HINT = "document.querySelector('#hint').hidden ? '' : document.querySelector('#hint').textContent"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 30 s in which s3 dies at 10 s."""
    path = tmp_path_factory.mktemp("page") / "some.mcap"
    deaths = FaultSettings(at=10.0, verb="kill", who="s3")
    simulation = Simulation(msgspec.structs.replace(resolve("quick", {"run.seconds": 30.0}), faults=(deaths,)))
    Observers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
    simulation.run()
    return path


@pytest.fixture
def url(covey: Covey, file: Path) -> str:
    """The address of a replay."""
    return address(covey.start("replay", str(file), "--page", "0"))


def still(page: Any, url: str, time: float = 12.0) -> None:
    """Open a replay at a second, standing still, all of it scored and told: legend and tables have the room that they need."""
    page.goto(f"{url}?t={time}")
    stands = f"covey.frame.play.scanned && !covey.frame.play.playing && Math.abs(covey.frame.time - {time}) < 0.6"
    until(page, f"covey.frame && {stands} && covey.told === covey.frame")


def screen(page: Any, east: float, north: float) -> tuple[float, float]:
    """Where a place of the arena is on the screen, px, while the whole arena is seen."""
    width, height = page.evaluate("covey.hello.arena")
    left, top, wide, high = page.evaluate(f"(() => {{ const b = {BOX}; return [b.left, b.top, b.width, b.height]; }})()")
    scale = min((wide - 28) / width, (high - 28) / height)
    return left + wide / 2 + (east - width / 2) * scale, top + high / 2 - (north - height / 2) * scale


def test_hints_say_what_a_figure_and_an_agent_are_by_pointer_and_by_keyboard(url: str, page: Any) -> None:
    still(page, url)
    x, y = page.evaluate("(() => { const b = document.querySelector('#figure-OSPA').getBoundingClientRect(); return [b.left, b.top]; })()")
    at = round(x) + 4, round(y) + 4
    page.mouse.move(*at)
    until(page, f"({HINT}).includes('How far the estimates are from the true targets')")
    page.mouse.click(*at)
    until(page, f"({HINT}).includes('How far the estimates are from the true targets')")  # a finger has nothing but the click
    page.focus("#figure-GOSPA")
    page.keyboard.press("Tab")
    until(page, f"({HINT}).startsWith('Targets') && document.activeElement.getAttribute('aria-describedby') === 'hint'")
    page.keyboard.press("Escape")
    until(page, f"({HINT}) === ''")
    again = f"{{bubbles: true, pointerType: 'mouse', clientX: {at[0]}, clientY: {at[1]}}}"  # as browsers say it when the layout has changed
    page.evaluate(f"document.querySelector('#figure-OSPA').dispatchEvent(new PointerEvent('pointerover', {again})) && null")
    assert page.evaluate(HINT) == "", "a figure that is drawn anew under a resting pointer does not say it all again"
    east, north, _ = page.evaluate("covey.frame.agents[0].pose")
    page.mouse.move(*screen(page, east, north))
    until(page, f"({HINT}).startsWith('s1') && ({HINT}).includes('Its neighbours: s')")
    assert page.evaluate("covey.pointed") == "s1"


def test_wheel_drag_double_click_and_keys_zoom_and_move_the_arena(url: str, page: Any) -> None:
    still(page, url)
    east, north, _ = page.evaluate("covey.frame.agents[0].pose")
    x, y = screen(page, east, north)
    page.mouse.move(x, y)
    page.mouse.wheel(0, -120)
    until(page, "covey.view.zoom > 1.4")
    page.mouse.move(x + 1, y)
    until(page, f"({HINT}).startsWith('s1')")  # what was under the pointer stays there
    before = page.evaluate("covey.view.east")
    page.mouse.down()
    page.mouse.move(x - 60, y, steps=4)
    page.mouse.up()
    until(page, f"covey.view.east > {before} + 0.02")
    assert page.evaluate("covey.chosen") is None  # a drag is no click
    page.mouse.dblclick(x, y)
    until(page, "covey.view.zoom === 1 && covey.view.east === 0.5")
    page.keyboard.press("+")
    page.keyboard.press("+")
    until(page, "covey.view.zoom > 1.9")
    page.keyboard.press("Shift+ArrowRight")
    until(page, "covey.view.east > 0.55")
    page.keyboard.press("0")
    until(page, "!covey.view.moved")


def test_space_arrows_and_escape_do_what_people_expect_of_a_player(url: str, page: Any) -> None:
    still(page, url)
    page.keyboard.press("ArrowRight")
    until(page, "Math.abs(covey.frame.time - 13) < 0.6")
    page.keyboard.press("Shift+ArrowLeft")
    until(page, "Math.abs(covey.frame.time - 3) < 0.6")
    page.keyboard.press("Space")
    until(page, "covey.frame.play.playing && covey.frame.time > 4")
    page.keyboard.press("Space")
    until(page, "!covey.frame.play.playing")
    box = page.locator("#scrub").bounding_box()
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    until(page, "Math.abs(covey.frame.time - 15) < 1")
    page.keyboard.press("Space")  # the slider that was clicked has not kept the focus
    until(page, "covey.frame.play.playing")
    page.keyboard.press("Space")
    until(page, "!covey.frame.play.playing")
    page.keyboard.press("ArrowDown")
    until(page, "covey.chosen === 's1' && covey.belief")
    page.wait_for_timeout(900)
    asked = page.evaluate(ASKED)
    page.wait_for_timeout(900)
    assert page.evaluate(ASKED) == asked, "while nothing moves nothing is asked"
    page.keyboard.press("?")
    page.keyboard.press("Escape")
    assert page.evaluate("covey.chosen") == "s1" and page.is_hidden("#help")
    page.keyboard.press("Escape")
    assert page.evaluate("covey.chosen") is None


def test_a_curve_is_read_at_a_second_and_an_address_opens_there(url: str, page: Any) -> None:
    still(page, url)
    curve = page.locator("#charts canvas").first
    box = curve.bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    until(page, "covey.readout > 8 && covey.readout < 20")
    page.mouse.move(5, 5)
    until(page, "covey.readout === null")
    page.keyboard.press("ArrowDown")
    page.click("#address")
    page.goto(page.url)
    until(page, "covey.frame && covey.chosen === 's1' && Math.abs(covey.frame.time - 12) < 0.6 && !covey.frame.play.playing")
    with page.expect_download() as found:
        page.click("#png")
    assert found.value.suggested_filename.endswith("s.png")
    assert Path(found.value.path()).read_bytes().startswith(b"\x89PNG")
    page.click("#film")
    page.wait_for_timeout(500)
    with page.expect_download() as found:
        page.click("#film")
    with Image.open(found.value.path()) as film:
        assert film.format == "GIF" and film.n_frames >= 2 and film.width <= 720 and film.info["duration"] == 100


def test_a_dead_agents_cell_fades_and_the_legend_knows_what_is_drawn(url: str, page: Any) -> None:
    still(page, url, 9.0)
    assert "dead" not in page.inner_text("#legend")
    assert page.evaluate("covey.scene.fading.length") == 0
    page.click("#play")
    until(page, "covey.scene.fading.length === 1 && covey.scene.fading[0].index === 2")
    until(page, "covey.frame.time > 16 && covey.scene.fading.length === 0")
    until(page, "document.querySelector('#legend').textContent.includes('dead')")
    page.click("#switch-estimates")
    until(page, "!document.querySelector('#legend').textContent.includes('estimate')")
    assert "s3 is gone" in page.inner_text("#log")


def test_the_tour_has_five_steps_is_skipped_with_escape_and_remembered(covey: Covey, page: Any) -> None:
    url = address(covey.start("demo", "quick", "--page", "0", "--seconds", "200"))
    page.set_viewport_size({"width": 390, "height": 844})
    alive(page, url)
    for step in range(1, 6):
        assert page.inner_text("#tour small") == f"{step} of 5"
        assert step in (1, 4) or page.evaluate(APART), f"step {step} hides what it explains"
        page.keyboard.press("Enter")  # the button for the next step has the focus
    assert page.is_hidden("#tour")
    page.reload()
    until(page, "covey.frame && covey.frame.tick > 4")
    assert page.is_hidden("#tour")
    page.click("#guide")
    assert page.is_visible("#tour")
    page.keyboard.press("Escape")
    assert page.is_hidden("#tour")
    page.keyboard.press("Space")
    until(page, "covey.held && document.querySelector('#link').textContent.startsWith('held')")
    tick = page.evaluate("covey.frame.tick")
    page.wait_for_timeout(700)
    assert page.evaluate("covey.frame.tick") == tick
    assert page.evaluate("(document.querySelector('#hold').click(), covey.frame.tick)") > tick, "the newest frame has waited"
    until(page, f"covey.frame.tick > {tick + 1}")
    tick = page.evaluate(SEEN % "true" + ", covey.frame.tick")
    page.wait_for_timeout(700)
    assert page.evaluate("covey.frame.tick") == tick, "nothing is drawn for a page that nobody sees"
    assert page.evaluate(SEEN % "false" + ", covey.frame.tick") > tick
    page.goto("about:blank")  # a page that is open would complain that its server has gone
    assert covey.run("down")[0] == 0


@pytest.mark.parametrize("page", ["ERR_CONNECTION_REFUSED"], indirect=True)
def test_a_page_whose_server_ends_says_so_and_shows_the_next_one_at_the_same_place(covey: Covey, file: Path, page: Any) -> None:
    """The next one replays a run in which nobody is called s6, and whose agents have long names."""
    names = ("reconnaissance-quadcopter-of-the-second-flight-01", "robot")
    other = covey.folder / "other.mcap"
    members = {f"members.{name}": "A" for name in names}
    simulation = Simulation(resolve("quick", {"run.seconds": 5.0, "run.name": "other", "team.composition": "", **members}))
    Observers(simulation.scorer, open_recorder(other, simulation.scenario, virtual=True))
    simulation.run()
    process = covey.start("replay", str(file), "--page", "0")
    url = address(process)
    page.goto(f"{url}?t=12&agent=s6")
    until(page, "covey.frame && covey.belief && !covey.frame.play.playing")
    process.send_signal(signal.SIGINT)
    until(page, "document.querySelector('#link').textContent === 'the server has ended'")
    page.keyboard.press("Space")
    until(page, "document.querySelector('#answer').textContent.includes('no connection')")
    process.wait(timeout=60)
    page.wait_for_event("console", lambda said: "ERR_CONNECTION_REFUSED" in said.text)  # the page has looked for a server in vain
    address(covey.start("replay", str(other), "--page", url.rstrip("/").rpartition(":")[2]))
    until(page, "covey.hello.run === 'other' && covey.frame.agents.length === 2 && covey.told === covey.frame")
    assert page.evaluate("covey.chosen") is None and page.is_hidden("#belief")
    assert page.inner_text("#link") == "replay"
    assert page.evaluate("document.querySelector('#roster').offsetWidth <= document.querySelector('#team').clientWidth")


def test_two_diagrams_go_in_step_and_a_target_follows_the_pointer_on_both_sides(covey: Covey, page: Any) -> None:
    page.goto(address(covey.start("compare", "quick", "--seconds", "300", "--page", "0", "--set", "targets.speed=0.05")))
    until(page, "covey.frame && covey.frame.beside && covey.frame.tick > 20")
    assert page.evaluate("covey.frame.tick === covey.frame.beside.tick && covey.frame.targets.join() === covey.frame.beside.targets.join()")
    assert page.evaluate("covey.frame.agents.map((one) => one.cell).join() !== covey.frame.beside.agents.map((one) => one.cell).join()")
    assert page.get_attribute("#beside", "aria-label") == "The same run with voronoi, from above"
    assert "choose an agent" in page.inner_text("#help dt:text-is('← →') + dd")
    page.evaluate(WRITTEN)
    until(page, "errors.length > 20")
    assert [one for one, other in page.evaluate("errors") if one != other] == [], "the arena says what the figures say"
    page.click("#switch-names")
    page.evaluate("['cells', 'density'].forEach((name) => document.querySelector(`#switch-${name}`).click())")
    page.keyboard.press("Space")
    until(page, "!covey.frame.play.playing")
    page.evaluate(
        "written.length = 0, covey.frame.agents.forEach((one, index) => { one.pose = [4, covey.hello.arena[1] - 4 * index, 0]; })"
    )
    page.keyboard.press("n")
    until(page, "written.some(({ text }) => text === 's1')")
    assert page.evaluate(OVERWRITTEN) == []
    page.evaluate("window.behind = '', covey.frame.beside.time -= 3")
    page.keyboard.press("n")
    until(page, "/^voronoi, OSPA .* m, 3.0 s behind$/.test(behind)")
    number, east, north = page.evaluate(FREE_TARGET)
    x, y = screen(page, east, north)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(*screen(page, 12.0, 12.0), steps=6)
    page.mouse.up()
    page.keyboard.press("Space")
    for frame in ("covey.frame", "covey.frame.beside"):
        until(page, f"{MOVED}({frame}, {number})")
    page.keyboard.press("ArrowDown")
    page.click("#belief [data-verb=kill]")
    until(page, "covey.frame.agents[0].state === 'dead' && covey.frame.beside.agents[0].state === 'dead'")
    until(page, "document.querySelector('#log').textContent.includes('s1 is killed on both sides')")


ASKED = "performance.getEntriesByType('resource').filter(({ name }) => name.includes('/api/agent/')).length"
SEEN = "Object.defineProperty(document, 'hidden', { value: %s, configurable: true }), document.dispatchEvent(new Event('visibilitychange'))"
APART = """(() => {
  const box = (name) => document.querySelector(name).getBoundingClientRect();
  const card = box('#tour'), thing = box('.toured'), player = box('footer');
  return thing.top >= 0 && thing.bottom <= player.top + 1 && (card.bottom <= thing.top || thing.bottom <= card.top);
})()"""  # neither the card nor the player covers the thing
WRITTEN = """window.written = [], window.errors = [];
const fill = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, x, y, ...most) {
  const wide = this.measureText(text).width, left = this.textAlign === 'center' ? x - wide / 2 : x;
  if (this.canvas.id === 'arena') window.written.push({ text, left, right: left + wide, y: this.textBaseline === 'middle' ? y + 6 : y });
  if (text.endsWith('behind')) window.behind = text;
  const figure = document.querySelector('#figure-OSPA b').firstChild;
  if (text.startsWith('power, OSPA')) window.errors.push([text.split(' ')[2], figure.textContent]);
  return fill.call(this, text, x, y, ...most);
};
null"""  # words on the left arena, each with the place of its foot; the error there and among the figures; which side lags
OVERWRITTEN = """(() => {
  const title = written.find(({ text }) => text.startsWith('power'));
  const near = ({ left, right, y }) => Math.abs(y - title.y) < 10 && left < title.right && right > title.left;
  return written.filter((one) => /^s[0-9]+$/.test(one.text) && near(one)).map(({ text }) => text);
})()"""
MOVED = "(({ids, targets}, id, at = 2 * ids.indexOf(id)) => Math.hypot(targets[at] - 12, targets[at + 1] - 12) < 3)"
UNEXPLAINED = """import('/texts.js').then(({ TEXTS }) =>
  [...document.querySelectorAll('[data-hint]')].map((thing) => thing.dataset.hint).filter((name) => !TEXTS[name]))"""
SMALL = """[...document.querySelectorAll('button, select')]
  .filter((thing) => thing.offsetParent && Math.min(thing.offsetWidth, thing.offsetHeight) < 43.9)
  .map((thing) => thing.id || thing.textContent)"""
FREE_TARGET = """(() => {
  const { ids, targets, agents } = covey.frame;
  const free = (i) => Math.min(...agents.map(({ pose }) => Math.hypot(pose[0] - targets[2 * i], pose[1] - targets[2 * i + 1])));
  const best = [...ids.keys()].sort((a, b) => free(b) - free(a))[0];
  return [ids[best], targets[2 * best], targets[2 * best + 1]];
})()"""  # the one that is farthest from all bodies, which lie above targets


def test_at_every_size_and_in_both_themes_nothing_is_wide_small_or_a_barrier(url: str, page: Any) -> None:
    """Nothing reaches beyond the window, buttons of small screens have 44 px, the player is in reach, and axe finds nothing serious."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs the Python package axe-playwright-python").Axe()
    still(page, url)
    page.click("#guide")
    page.keyboard.press("ArrowDown")
    assert page.evaluate(UNEXPLAINED) == []
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(300)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(
            "(() => { const b = document.querySelector('#play').getBoundingClientRect(); return b.top >= 0 && b.bottom <= innerHeight; })()"
        )
        if width < 900:
            assert page.evaluate(SMALL) == []
        for _ in range(2):
            page.keyboard.press("x")
            found = [
                (one["id"], one["nodes"][0]["target"])
                for one in axe.run(page).response["violations"]
                if one["impact"] in ("serious", "critical")
            ]
            assert found == [], (width, height, found)


CLIPPED = """(() => {
  const link = document.querySelector('#link');
  link.className = 'off';
  link.textContent = 'live; this machine is too small for 10 agents at rate 1 (45 % of the ticks come): take --rate 0.45 or less';
  document.querySelector('#figures b small').textContent = 'rounds, 84 late';
  return ['#link', '#clock', '#figures button'].filter((name) => {
    const thing = document.querySelector(name);
    return thing.scrollWidth > thing.clientWidth;
  });
})()"""


def test_advice_about_the_machine_and_rounds_that_were_late_can_be_read(url: str, page: Any) -> None:
    still(page, url)
    assert page.evaluate(CLIPPED) == []
