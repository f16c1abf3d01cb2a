"""After `heal` nothing is left of what was done to the links."""

from deploy.faults.faults import Action, Schedule
from deploy.faults.links import Links
from deploy.scenario import FaultSettings

NAMES = ["s1", "s2", "s3"]


def test_healing_clears_cuts_and_conditions_alike() -> None:
    links = Links(1, NAMES)
    links.act(Action("partition", ["s1"]))
    links.act(Action("drop", NAMES, 1.0))
    links.act(Action("delay", NAMES, 0.5))
    assert links.carry("s2", "s1", "key", b"word", 0.0) == [] == links.carry("s2", "s3", "key", b"word", 0.0)
    assert links.torn("s1", "s2")
    links.act(Action("heal", NAMES))
    for sender in NAMES:
        for receiver in NAMES:
            if sender != receiver:
                assert links.carry(sender, receiver, "key", b"word", 0.0) == [(0.0, b"word")]
                assert not links.torn(sender, receiver)


def test_the_end_of_a_partition_leaves_a_loss_and_another_cut_as_they_are() -> None:
    links = Links(1, [*NAMES, "s4"])
    links.act(Action("drop", ["s2", "s3"], 0.5))
    links.act(Action("partition", ["s1"]))
    links.act(Action("partition", ["s4"]))
    links.act(Action("heal", ["s1"], None, {"only_cut": True}))
    assert not links.torn("s1", "s2") and links.torn("s4", "s2")
    assert links.reception("s2").cut == ("s4",)
    assert links.reception("s2").conditions["s3"].drop == 0.5
    assert links.describe(Action("heal", ["s1"], None, {"only_cut": True})) == "s1: no longer cut off"
    assert links.describe(Action("partition", [])) == "nobody to partition"
    assert links.describe(Action("drop", [], 0.5)) == "nobody to drop"
    bridge = Action("partition", NAMES, None, {"kind": "bridge"})
    assert links.describe(bridge) == "nobody is on the other side of a cut around s1, s2, s3"


def test_a_healing_is_of_everything_and_the_end_of_a_partition_is_of_its_cut() -> None:
    faults = (FaultSettings(at=0.0, verb="partition", who="s1", seconds=2.0), FaultSettings(at=3.0, verb="heal"))
    schedule = Schedule(1, faults)
    said = [schedule.due(float(time), NAMES, [], NAMES) for time in range(4)]
    assert said[2] == [Action("heal", ["s1"], None, {"only_cut": True})] and said[3] == [Action("heal", NAMES)]
