"""A recording as messages, and tick by tick for drawings in the forms of other tools."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from deploy.page.picture import Picture
from deploy.recording.recording import Recording, event_of
from deploy.recording.rescore import rescore_slowly
from deploy.scoring.scorer import Scorer
from protocol.message import Message
from protocol.node import messages_of

PALETTE = ("77aadd", "ee8866", "44bb99", "eedd88", "ffaabb", "99ddff", "bbcc33", "c9a4e0", "aaaa00")  # Paul Tol's "light"


def messages(recording: Recording) -> Iterator[Message]:
    """The valid messages of a recording in order."""
    for entry in recording.entries():
        yield from messages_of(event_of(entry))


class Moment(NamedTuple):
    """A tick of which everything has been heard; the picture shows it until the next moment is asked for."""

    picture: Picture
    time: float  # of this tick, s of the world


def moments(recording: Recording, scorer: Scorer) -> Iterator[Moment]:
    """Every tick of which the world has told, once. At the end the scorer has all scores, those of ticks with late estimates, too."""
    picture, heard = Picture(recording.scenario), -1  # the newest tick
    scorer.on_event = picture.see
    scorer.on_report = lambda told: picture.note("told", told.who, told.text, told.time)
    faults = deque(recording.faults)
    for reached in rescore_slowly(recording, scorer):
        while faults and faults[0].time <= reached:
            picture.note_fault(faults.popleft())
        if picture.truth is not None and picture.truth.tick > heard:
            if heard >= 0:
                yield _moment(picture, heard)
            heard = picture.truth.tick
    if heard >= 0:
        yield _moment(picture, heard)


def _moment(picture: Picture, tick: int) -> Moment:
    picture.show(tick)
    assert picture.shown is not None
    return Moment(picture, picture.shown.time)


def colour_of(index: int) -> tuple[float, float, float]:
    """Red, green and blue of the agent number `index`, from 0 to 1."""
    text = PALETTE[index % len(PALETTE)]
    red, green, blue = (int(text[at : at + 2], 16) / 255.0 for at in (0, 2, 4))
    return red, green, blue
