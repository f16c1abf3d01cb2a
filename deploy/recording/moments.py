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
from protocol.observer_messages import Truth

PALETTE = ("77aadd", "ee8866", "44bb99", "eedd88", "ffaabb", "99ddff", "bbcc33", "c9a4e0", "aaaa00")  # Paul Tol's "light"


def messages(recording: Recording) -> Iterator[Message]:
    """The valid messages of a recording in order."""
    for entry in recording.entries():
        yield from messages_of(event_of(entry))


class Moment(NamedTuple):
    """A tick of which everything has been heard; the picture shows it until the next moment is asked for."""

    picture: Picture
    truth: Truth  # of this tick


def moments(recording: Recording, scorer: Scorer | None = None) -> Iterator[Moment]:
    """Every tick of which the world has told, once the next but one begins: the gossips of the next one hold its particles.

    A scorer that is given has all scores at the end, those of ticks with late estimates, too; without one nothing is scored.
    """
    scorer = scorer or Scorer(recording.scenario, scores=False, recorded=True)
    picture = Picture(recording.scenario)
    waiting: deque[int] = deque()  # ticks that have begun
    scorer.on_event = picture.see
    scorer.on_report = lambda told: picture.note("told", told.who, told.text, told.time)
    faults = deque(recording.faults)
    for reached in rescore_slowly(recording, scorer):
        while faults and faults[0].time <= reached:
            picture.note_fault(faults.popleft())
        if picture.truth is not None and (not waiting or picture.truth.tick > waiting[-1]):
            waiting.append(picture.truth.tick)
            if len(waiting) > 2:
                yield _moment(picture, waiting.popleft())
    while waiting:
        yield _moment(picture, waiting.popleft())


def _moment(picture: Picture, tick: int) -> Moment:
    picture.show(tick)
    assert picture.shown is not None
    return Moment(picture, picture.shown)


def colour_of(index: int) -> tuple[float, float, float]:
    """Red, green and blue of the agent number `index`, from 0 to 1."""
    text = PALETTE[index % len(PALETTE)]
    red, green, blue = (int(text[at : at + 2], 16) / 255.0 for at in (0, 2, 4))
    return red, green, blue
