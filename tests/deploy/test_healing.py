"""After `heal` nothing is left of what was done to the links."""

from deploy.faults.faults import Action
from deploy.faults.links import Links

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
