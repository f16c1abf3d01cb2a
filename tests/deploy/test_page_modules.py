"""Modules of the page in Node: events become sentences, trails follow labels, cells of the dead fade, the view keeps its place."""

import re
from statistics import median

from deploy.page.server import STATIC
from tests.node import needs_node, node

pytestmark = needs_node
HINT = re.compile(r"data-hint\"?[=:,] ?\"([^\"]+)\"")


def test_what_befalls_several_agents_at_once_is_one_sentence_and_a_command_stands_alone() -> None:
    happened = [
        [1, 9.0, "asked", "s2", "from the page: killed s2"],
        [2, 9.1, "lost", "s2", "s2 is gone"],
        [3, 9.1, "told", "s2", "s2 died: s1 took its cell"],
        [4, 9.6, "lost", "s5", "s5 is gone"],
        [5, 9.9, "lost", "s7", "s7 is gone"],
        [6, 12.0, "lost", "s1", "s1 is gone"],
    ]
    groups = node("grouped(data).map((group) => group.text)", happened, "log")
    assert groups == ["from the page: killed s2", "s2, s5 and s7 are gone", "s2 died: s1 took its cell", "s1 is gone"]


def frame(time: float, **agent: object) -> dict[str, object]:
    """A frame of one agent."""
    return {"time": time, "ids": [], "targets": [], "agents": [{"name": "s1", "state": "alive", "pose": [1, 1, 0], "said": time, **agent}]}


SEEN = """(() => {
  const scene = new Scene();
  scene.begin({ agents: [{}], dt: DT }, { bodies: {}, targets: {} });
  data.forEach((one) => scene.take(one));
  return %s;
})()""".replace("DT", "0.25")


def test_estimates_with_labels_leave_trails_by_label_and_others_leave_none() -> None:
    labelled = [frame(1, targets=[5, 5, 9, 9], labels=[3, 4]), frame(2, targets=[9, 8, 5, 6], labels=[4, 3])]
    assert node(SEEN % "Object.fromEntries(scene.trails.labels)", labelled, "scene") == {"3": [1, 5, 5, 2, 5, 6], "4": [1, 9, 9, 2, 9, 8]}
    assert node(SEEN % "scene.trails.labels.size", [frame(1, targets=[5, 5])], "scene") == 0


def test_the_cell_of_one_that_has_died_fades_for_four_seconds_and_a_jump_forgets_it() -> None:
    square, gone = [0, 0, 1, 0, 1, 1], {"state": "dead", "cell": []}
    died = [frame(1, cell=square), frame(2, **gone)]
    assert node(SEEN % "scene.fading", died, "scene") == [{"index": 0, "cell": square, "time": 2}]
    assert node(SEEN % "scene.fading", [*died, frame(5.9, **gone)], "scene") != []
    assert node(SEEN % "scene.fading", [*died, frame(6, **gone)], "scene") == []
    assert node(SEEN % "scene.fading", [*died, frame(1.5, cell=square)], "scene") == []
    assert node(SEEN % "scene.fading", [died[0], frame(5.1, **gone)], "scene") == [], "it may have died long before this moment"


def test_fading_and_trails_last_for_some_ticks_at_least() -> None:
    square, gone = [0, 0, 1, 0, 1, 1], {"state": "dead", "cell": []}
    slow = SEEN.replace("0.25", "5")
    frames = [frame(5, cell=square), frame(10, **gone), frame(45, **gone)]
    assert node(slow % "[scene.fading.length, scene.fade, scene.trail]", frames, "scene") == [1, 40, 120]
    assert node(SEEN % "[scene.fade, scene.trail]", [], "scene") == [4, 12]


def test_large_numbers_have_fewer_digits() -> None:
    numbers = [0.0, 6.472, 131.74, 2371.71, -2371.71, 17671457.8]
    assert node("data.map((number) => short(number, 2))", numbers, "texts") == ["0.00", "6.47", "131.7", "2372", "-2372", "1.77e7"]


def test_marks_are_half_as_large_at_least_where_most_would_cover_their_nearest() -> None:
    three = [0.0, 0.0, 10.0, 0.0, 30.0, 0.0]  # m; the nearest are 10, 10 and 20 m away
    assert node("[2, 1.2, 0.9, 0.1].map((scale) => room(data, 6, scale))", three, "shapes") == [1, 1, 0.75, 0.5]
    assert node("[room([], 6, 1), room([1, 1], 6, 1)]", 0, "shapes") == [1, 1]


def test_of_two_marks_at_one_place_of_the_time_line_the_death_stands() -> None:
    happened = [[1, 9.9, "asked", "s2", ""], [2, 10.0, "lost", "s2", ""], [3, 12.3, "told", "s2", ""], [4, 10.2, "lost", "s3", ""]]
    assert node("apart(data, 1)", happened, "curves") == [[10.0, "lost"], [12.3, "told"]]
    assert sorted(node("apart(data, 0)", happened, "curves")) == [[9.9, "asked"], [10.0, "lost"], [10.2, "lost"], [12.3, "told"]]


def test_a_curve_that_is_thinned_out_keeps_holes_of_one_tick() -> None:
    scores = [[0.25 * tick, 1, 1, 8, 8, 8, 0.1 if tick in (1001, 1702) else 0, 0] for tick in range(2401)]
    made = "(() => { const history = fresh(); data.forEach((score) => append(history, score, 5)); return [history.time, history.hole]; })()"
    times, holes = node(made, scores, "curves")
    assert len(times) == 1201
    assert [time for time, hole in zip(times, holes) if hole] == [1001 * 0.25, 1702 * 0.25]


def test_gossip_is_fresh_in_the_frame_that_brings_a_new_one_alone() -> None:
    frames = [frame(1), frame(2), frame(3, said=2)]
    assert node(SEEN % "scene.said.get('s1')", frames[:2], "scene") == {"tick": 2, "count": 2, "fresh": True}
    assert node(SEEN % "scene.said.get('s1')", frames, "scene") == {"tick": 2, "count": 2, "fresh": False}


def test_zoom_keeps_the_place_under_the_pointer_and_stays_within_the_arena() -> None:
    made = "const view = new View(() => {})"
    # a point at 0.6 of the arena is 0.1 right of the centre; twice as large, it is where it was when the centre is at 0.55
    assert node(f"(() => {{ {made}; view.by(2, 0.6, 0.5); return [view.zoom, view.east, view.north]; }})()", 0, "view") == [2, 0.55, 0.5]
    assert node(f"(() => {{ {made}; view.by(4); view.pan(9, -9); return [view.east, view.north]; }})()", 0, "view") == [0.875, 0.125]
    assert node(f"(() => {{ {made}; view.by(0.1); return view.zoom; }})()", 0, "view") == 1


def test_a_speed_between_those_of_the_list_is_followed_by_the_next_of_them() -> None:
    speeds, asked = [0.5, 1, 2, 5, 10, 30], [[4, 1], [4, -1], [5, 1], [5, -1], [30, 1], [100, 1], [100, -1], [0.5, -1], [0.1, 1]]
    steps = node("data[1].map(([now, steps]) => nextSpeed(data[0], now, steps))", [speeds, asked], "player")
    assert steps == [5, 2, 10, 2, 30, 100, 30, 0.5, 0.5]


def test_every_hint_has_a_text_of_short_sentences() -> None:
    texts = node("TEXTS", 0, "texts")
    tour = node("TOUR", 0, "texts")
    sources = "".join(file.read_text(encoding="utf-8") for file in STATIC.iterdir() if file.suffix in (".html", ".js"))
    named = set(HINT.findall(sources))
    assert len(named) > 15 and named <= set(texts)
    assert {"OSPA", "hole", "U", "centroids", "claim"} <= set(texts)
    lengths = [len(line.split()) for _, *lines in texts.values() for line in lines]
    assert median(lengths) <= 15 and max(lengths) <= 20
    assert len(tour) == 5 and all(step["at"].removeprefix("#") in sources for step in tour)


def test_the_explanations_of_errors_say_the_cut_off_of_the_run() -> None:
    told = node("(tellCutoff(data), [TEXTS.OSPA[2], TEXTS.GOSPA[3]])", 200.0, "texts")
    assert told == ["A missed or an invented target counts as 200 m.", "Each missed or invented target adds 100 m."]
    assert "tellCutoff(message.cutoff);" in (STATIC / "main.js").read_text(encoding="utf-8")
