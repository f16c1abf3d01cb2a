"""The links of a swarm: who hears whom after each verb."""

from deploy.faults.faults import Action, Schedule
from deploy.faults.links import Links, other_side
from deploy.scenario import FaultSettings
from protocol.link_faults import LinkCondition

TEAM = ["s1", "s2", "s3", "s4"]


def hears(links: Links) -> set[tuple[str, str]]:
    """(sender, receiver) of all directions that carry something."""
    return {(a, b) for a in [*TEAM, "world"] for b in [*TEAM, "world"] if a != b and links.carry(a, b, "key", b"x", 0.0)}


ALL = hears(Links(1, TEAM))


def test_without_faults_everybody_hears_everybody() -> None:
    assert len(ALL) == 20


def test_a_partition_cuts_both_ways_between_those_meant_and_the_rest_and_spares_the_world() -> None:
    links = Links(1, TEAM)
    links.act(Action("partition", ["s1", "s2"]))
    assert ALL - hears(links) == {(a, b) for a, b in ALL if {a, b} <= set(TEAM) and (a in ("s1", "s2")) != (b in ("s1", "s2"))}
    assert links.torn("s1", "s3") and links.torn("s3", "s1") and not links.torn("s1", "s2")
    links.act(Action("heal", []))
    assert hears(links) == ALL and not links.torn("s1", "s3")


def test_one_way_the_rest_hear_nothing_and_a_bridge_hears_both_sides() -> None:
    links = Links(1, TEAM)
    links.act(Action("partition", ["s1"], None, {"kind": "one-way", "tokens": False}))
    assert ALL - hears(links) == {("s1", "s2"), ("s1", "s3"), ("s1", "s4")} and not links.torn("s1", "s2")
    links.act(Action("heal", []))
    links.act(Action("partition", ["s1"], None, {"kind": "bridge"}))
    assert ALL - hears(links) == {("s1", "s3"), ("s1", "s4"), ("s3", "s1"), ("s4", "s1")}
    links.act(Action("heal", []))
    links.act(Action("partition", ["s1"], None, {"kind": "bridge"}), ["s1", "s3", "s4"])
    assert ALL - hears(links) == {("s1", "s2"), ("s1", "s4"), ("s2", "s1"), ("s4", "s1")}, "the dead are no bridge"
    assert other_side(["s1"], TEAM, "bridge", ["s1"]) == ["s3", "s4"] and other_side(TEAM, TEAM, "bridge", []) == []


def test_sides_are_groups_that_hear_nothing_of_each_other_among_those_asked_about() -> None:
    links, cut = Links(1, TEAM), {"kind": "both"}
    assert links.sides(TEAM) == 1 and links.sides([]) == 0
    for names, sides in ((["s1", "s2"], 2), (["s1", "s2"], 2), (["s2"], 3)):
        links.act(Action("partition", names, None, cut))
        assert links.sides(TEAM) == sides
    assert links.sides(["s1", "s3", "s4"]) == 2 and links.sides(["s3", "s4"]) == 1
    links.act(Action("heal", ["s1"], None, {"only_cut": True}))
    assert links.sides(TEAM) == 1 and links.sides(["s2", "s3"]) == 2  # s1 hears both
    for kind in ("one-way", "bridge"):
        links.act(Action("heal", []))
        links.act(Action("partition", ["s1"], None, {"kind": kind}))
        assert links.sides(TEAM) == 1


def test_the_world_is_cut_off_only_by_name() -> None:
    links = Links(1, TEAM)
    links.act(Action("partition", ["world"]))
    assert ALL - hears(links) == {(a, b) for a, b in ALL if "world" in (a, b)}


def test_conditions_add_up_and_zero_clears_them() -> None:
    links = Links(1, TEAM)
    links.act(Action("delay", ["s1"], 0.5, {"jitter": 0.0}))
    links.act(Action("drop", ["s2"], 1.0))
    assert links.carry("s1", "s3", "key", b"x", 0.0) == [(0.5, b"x")] and links.carry("s3", "s1", "key", b"x", 0.0) == [(0.5, b"x")]
    assert ALL - hears(links) == {(a, b) for a, b in ALL if "s2" in (a, b) and "world" not in (a, b)}
    assert set(links.reception("s2").conditions) == {"s1", "s3", "s4"}
    links.act(Action("drop", ["s2"], 0.0))
    links.act(Action("delay", ["s1"], 0.0))
    assert hears(links) == ALL and links.reception("s2").conditions == {}


def test_the_jitter_of_a_delay_ends_with_the_delay() -> None:
    links = Links(1, ["a", "b"])
    schedule = Schedule(1, [FaultSettings(at=0.0, verb="delay", who="a", value=0.1, seconds=5.0, options={"jitter": 0.5})])
    found = []
    for time in (0.0, 5.0):
        for action in schedule.due(time, ["a", "b"], [], ["a", "b"]):
            links.act(action)
        found.append(dict(links.reception("b").conditions))
    assert found[0] and not found[1]


def test_bursts_end_with_the_losses_though_another_fault_goes_on() -> None:
    links = Links(1, ["a", "b"])
    links.act(Action("drop", ["a"], 0.3, {"burst": 8.0}))
    links.act(Action("delay", ["a"], 0.1))
    links.act(Action("drop", ["a"], 0.0))
    assert links.reception("b").conditions["a"] == LinkCondition(delay=0.1)


def test_a_jitter_without_a_delay_is_a_fault_too() -> None:
    links = Links(1, ["a", "b"])
    links.act(Action("delay", ["a"], 0.0, {"jitter": 0.2}))
    assert links.reception("b").conditions["a"] == LinkCondition(jitter=0.2)


def test_the_spread_of_copies_ends_with_them_and_is_not_that_of_a_later_reordering() -> None:
    links = Links(1, ["a", "b"])
    links.act(Action("drop", ["a"], 0.1))
    links.act(Action("duplicate", ["a"], 0.5, {"spread": 8.0}))
    links.act(Action("duplicate", ["a"], 0.0))
    links.act(Action("reorder", ["a"], 0.3))
    assert links.reception("b").conditions["a"] == LinkCondition(drop=0.1, reorder=0.3)
    links.act(Action("reorder", ["a"], 0.3, {"spread": 0.4}))
    links.act(Action("duplicate", ["a"], 0.5))
    links.act(Action("duplicate", ["a"], 0.0))
    assert links.reception("b").conditions["a"] == LinkCondition(drop=0.1, reorder=0.3, spread=0.4)


def test_a_newcomer_is_cut_off_like_all_others() -> None:
    links = Links(1, TEAM)
    links.add("s9")
    links.act(Action("partition", ["s9"]))
    assert links.carry("s1", "s9", "key", b"x", 0.0) == [] and links.carry("s9", "s2", "key", b"x", 0.0) == []


def test_a_verb_says_what_it_did() -> None:
    links = Links(1, TEAM)
    assert links.describe(Action("drop", ["s1", "s2"], 0.25)) == "drop 25 % of the messages from and to s1, s2"
    assert links.describe(Action("delay", ["s1"], 0.5)) == "delay 0.5 s from and to s1"
    assert links.describe(Action("partition", ["s1", "s2"], None, {"kind": "one-way"})) == "none of the rest hears s1, s2"
