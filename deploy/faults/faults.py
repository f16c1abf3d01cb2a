"""Faults: the verbs, the agents selected by "s3", "s3,s4", "4" or "30%", and the schedule of a scenario's faults.

The words are the same in a scenario's [[faults]], on the command line, in a simulation and on real processes:

    kill, restart        a process vanishes; comes back under its name with its body where it stands
    pause, resume        a process is stopped in its tracks; goes on
    slow                 it takes `value` s over every round
    starve               it gets this share of the time that it needs to play every tick
    freeze               all processes, the world included, stand still for `value` s; without `who`
    join, twin           a newcomer (options.class), or a second process of a name
    jump                 its clock jumps by `value` s (options.back = true: back)
    partition            the selected and the rest do not hear each other (options.kind = "one-way": only the rest is deaf; "bridge":
                         one of the rest hears both sides); with options.tokens = false the sessions stay up
    drop, delay          a share of the messages is lost (options.burst: in runs of so many); all come `value` s late (options.jitter)
    throttle             every link carries `value` kbit/s, one message after the other; what would wait longer than options.queue s is lost
    duplicate, reorder   a share comes twice; is held back and overtaken (options.spread s at most)
    flip                 a share is spoilt: one wrong bit, or in every second case eight bytes of ones
    heal                 all links are clear again (options.only_cut = true: the selected are no longer cut off, losses and delays go on)

`seconds` ends a fault. The end of one ends every fault of its verb on the same agents.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from deploy.scenario import FaultSettings
from protocol.fields import RESERVED
from protocol.keys import NAME
from protocol.random_streams import stream
from protocol.settings import BadSetting

MOST = 1e9  # of any value: s, kbit/s
MOST_NAMED = 12  # processes that an error names; more are counted
NEED_WHO = "should be a name such as s3, a number such as 4, or a share such as 30%"
PROCESS_VERBS = ("kill", "pause", "resume", "restart", "slow", "starve", "freeze", "join", "twin", "jump")
LINK_VERBS = ("partition", "heal", "drop", "delay", "throttle", "duplicate", "reorder", "flip")
VERBS = (*PROCESS_VERBS, *LINK_VERBS)
LIVE_VERBS = ("kill", "pause", "resume", "restart", *LINK_VERBS)  # the others need a simulation
SYNONYMS = {"loss": "drop"}
SHARES = ("drop", "duplicate", "reorder", "flip", "starve")  # whose value is a share of the messages, or of the time
NEED_VALUE = (*SHARES, "delay", "throttle", "slow", "freeze", "jump")
INVERSE: dict[str, tuple[str, dict[str, Any]]] = {  # what ends a fault that lasts `seconds`
    "kill": ("restart", {}),
    "pause": ("resume", {}),
    "partition": ("heal", {"only_cut": True}),
}
ENDED_BY_ZERO = (*SHARES, "delay", "throttle", "slow")
WITH_END = (*INVERSE, *ENDED_BY_ZERO)  # that may last `seconds`
OPTIONS: dict[str, dict[str, type]] = {  # what a fault may say beside its value
    "kill": {"silent": bool},
    "join": {"class": str},
    "jump": {"back": bool},
    "partition": {"kind": str, "tokens": bool},
    "heal": {"only_cut": bool},
    "drop": {"burst": float},
    "delay": {"jitter": float},
    "throttle": {"queue": float},
    "duplicate": {"spread": float},
    "reorder": {"spread": float},
}
OF_ALL = {  # verbs that choose nobody, in words
    "freeze": "stops all processes",
    "heal": "clears all links; options.only_cut = true ends the cut of the chosen",
}
KINDS = ("both", "one-way", "bridge")
REFUSED = "refused"  # the verb of an action in place of a fault that cannot be carried out


class Action(NamedTuple):
    """One fault that is due, with the names of the selected processes."""

    verb: str
    names: list[str]
    value: float | None = None
    options: Mapping[str, Any] = {}


def choose(who: str, candidates: Sequence[str], known: Sequence[str], rng: np.random.Generator, where: str = "") -> list[str]:
    """Names selected by `who`: names with commas (any known one), or a number or a share of the candidates, drawn at random.

    The name of an agent that is called by a number comes before that number.
    A share is rounded to the nearest number, at least 1. Raises BadSetting naming what would be right; `where` stands before the field.
    """
    text = who.strip()
    if text in known:
        return [text]
    share = re.fullmatch(r"(\d+(?:\.\d+)?)\s*%", text)
    if share:
        percent = float(share[1])
        if percent > 100.0:
            raise BadSetting(f"{where}who = {who!r}: a share is at most 100%")
        number = max(1, int(percent / 100.0 * len(candidates) + 0.5)) if percent > 0.0 and candidates else 0
    elif text.isdecimal():
        number = int(text)
        if number > len(candidates):
            found = "1 agent qualifies" if len(candidates) == 1 else f"{len(candidates)} agents qualify"
            raise BadSetting(f"{where}who = {who!r}: only {found}")
    else:
        return _named(text, known, where)
    chosen = rng.choice(len(candidates), size=number, replace=False)
    return [candidates[index] for index in sorted(chosen.tolist())]


def _named(text: str, known: Sequence[str], where: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if "" in names:
        raise BadSetting(f"{where}who = {text!r}: {NEED_WHO}" + (", or names with a comma between two" if len(names) > 1 else ""))
    for name in names:
        if names.count(name) > 1:
            raise BadSetting(f"{where}who = {text!r}: names {name} twice")
        if name not in known:
            more = f" and {len(known) - MOST_NAMED} more" if len(known) > MOST_NAMED else ""
            raise BadSetting(
                f"{where}who = {name!r}: there is no such process; known are {', '.join(known[:MOST_NAMED])}{more}, "
                "a number such as 4, or a share such as 30%"
            )
    return names


def plain_verb(verb: str) -> str:
    """The verb by its first name."""
    return SYNONYMS.get(verb, verb)


def check_faults(
    faults: Sequence[FaultSettings], members: Sequence[str], others: Sequence[str] = (), *, live: bool = False, link_faults: bool = True
) -> None:
    """Raise BadSetting for a fault that cannot be carried out here. `others` are processes that are no agents."""
    for number in range(len(faults)):
        check_listed_fault(faults, number, members, others, live=live, link_faults=link_faults)


def check_listed_fault(
    faults: Sequence[FaultSettings], number: int, members: Sequence[str], others: Sequence[str], *, live: bool, link_faults: bool
) -> None:
    """Raise BadSetting when one of the faults of a scenario cannot be carried out here (`check_faults`)."""
    fault, where = faults[number], f"faults[{number}]."
    known = [*members, *newcomers(faults, number), *(others if plain_verb(fault.verb) in LIVE_VERBS else ())]
    check_fault(fault, where, members, known, live=live, link_faults=link_faults)
    if fault.verb == "join":
        if others and "world" not in others:
            right = "should be left out, or bodies.host be 'world': where bodies are processes of their own a newcomer gets none"
            raise BadSetting(f"{where}verb = 'join': {right}")
        _check_newcomer(newcomer(fault, number), where, [*known, *others])


def check_fault(fault: FaultSettings, where: str, members: Sequence[str], known: Sequence[str], *, live: bool, link_faults: bool) -> None:
    """Raise BadSetting when a fault cannot be carried out here; `where` stands before the names of its fields.

    A number or a share means some of the `members`; a name may be any of the `known` ones.
    """
    verb = plain_verb(fault.verb)
    if verb not in VERBS:
        raise BadSetting(f"{where}verb = {fault.verb!r}: should be one of {', '.join(VERBS)}")
    if live and verb not in LIVE_VERBS:
        raise BadSetting(f"{where}verb = {fault.verb!r}: works in a simulation only; live are {', '.join(LIVE_VERBS)}")
    if live and verb in LINK_VERBS and not link_faults:
        raise BadSetting(f"{where}verb = {fault.verb!r}: link faults need network.link_faults = true in the scenario")
    _check_value(fault, verb, where)
    _check_options(fault, verb, where)
    if fault.who and verb in OF_ALL and not fault.options.get("only_cut"):
        raise BadSetting(f"{where}who = {fault.who!r}: should be left out for {verb}, which {OF_ALL[verb]}")
    if verb == "join" or (_means_all(verb, fault.who) and verb != "partition"):
        return
    if not fault.who.strip():
        raise BadSetting(f"{where}who is missing: {NEED_WHO}")
    choose(fault.who, members, known, stream(0, "faults", 0), where)


def newcomer(fault: FaultSettings, number: int) -> str:
    """The name of the agent that joins in fault `number`."""
    return fault.who or f"guest{number}"


def newcomers(faults: Sequence[FaultSettings], number: int) -> list[str]:
    """The agents that join before fault `number`: at an earlier time, or at the same time and earlier in the list."""
    at = faults[number].at
    return [newcomer(one, place) for place, one in enumerate(faults) if one.verb == "join" and (one.at, place) < (at, number)]


def _check_newcomer(name: str, where: str, known: Sequence[str]) -> None:
    if not NAME.match(name):
        raise BadSetting(f"{where}who = {name!r}: should be 1 to 64 letters, digits, or any of _ . -")
    if name in (*known, *RESERVED):
        raise BadSetting(f"{where}who = {name!r}: there is a process of this name; a newcomer needs a name of its own")


def _means_all(verb: str, who: str) -> bool:
    """Whether a fault strikes all agents: a freeze does, and what is done to links without saying whose."""
    return verb == "freeze" or (verb in LINK_VERBS and not who)


def _check_value(fault: FaultSettings, verb: str, where: str) -> None:
    if fault.seconds is not None and verb not in WITH_END:
        raise BadSetting(f"{where}seconds = {fault.seconds:g}: should be left out for {verb}; only {', '.join(WITH_END)} take it")
    if verb in NEED_VALUE and fault.value is None:
        what = "a share between 0 and 1" if verb in SHARES else "a number of kbit/s" if verb == "throttle" else "a number of seconds"
        raise BadSetting(f"{where}value is missing: {verb} needs {what}")
    if verb not in NEED_VALUE and fault.value is not None:
        raise BadSetting(f"{where}value = {fault.value:g}: should be left out for {verb}; only {', '.join(NEED_VALUE)} take it")
    most = 1.0 if verb in SHARES else MOST
    if fault.value is not None and not 0.0 <= fault.value <= most:  # no number (nan) is neither
        raise BadSetting(f"{where}value = {fault.value:g}: should be {'a share between 0 and 1' if verb in SHARES else f'0 to {MOST:g}'}")


def _check_options(fault: FaultSettings, verb: str, where: str) -> None:
    known = OPTIONS.get(verb, {})
    for name, value in fault.options.items():
        if name not in known:
            raise BadSetting(f"{where}options.{name}: {verb} has no such option; known are {', '.join(known) or 'none'}")
        number = isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value <= MOST
        if not (number if known[name] is float else isinstance(value, known[name])):
            right = {float: f"a number from 0 to {MOST:g}", bool: "true or false", str: "a text"}[known[name]]
            raise BadSetting(f"{where}options.{name} = {value!r}: should be {right}")
    if fault.options.get("kind", "both") not in KINDS:
        raise BadSetting(f"{where}options.kind = {fault.options['kind']!r}: should be one of {', '.join(KINDS)}")
    if verb == "join" and "class" not in fault.options:
        raise BadSetting(f"{where}options.class is missing: a newcomer needs a sensor class")


@dataclass
class Schedule:
    """The faults of a scenario, each carried out once when the world's time has come."""

    seed: int
    faults: Sequence[FaultSettings]
    _next: int = 0
    _order: list[int] = field(default_factory=list)
    _ends: list[tuple[float, Action]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._order = sorted(range(len(self.faults)), key=lambda index: self.faults[index].at)

    def due(self, time: float, alive: Sequence[str], dead: Sequence[str], known: Sequence[str]) -> list[Action]:
        """Everything that is due at the world time `time`, s; draws from the dead for a restart, else from the living.

        In place of a fault that cannot be carried out, since too few agents qualify, stands an action `REFUSED`; its option says why.
        """
        actions = [action for at, action in self._ends if at <= time]
        self._ends = [end for end in self._ends if end[0] > time]
        while self._next < len(self._order) and self.faults[self._order[self._next]].at <= time:
            index = self._order[self._next]
            fault = self.faults[index]
            verb = plain_verb(fault.verb)
            self._next += 1
            try:
                names = self._names(index, verb, dead if verb == "restart" else alive, known)
            except BadSetting as error:
                actions.append(Action(REFUSED, [], None, {"why": str(error)}))
                continue
            actions.append(Action(verb, names, fault.value, fault.options))
            if fault.seconds is not None and verb in INVERSE:
                inverse, options = INVERSE[verb]
                self._ends.append((fault.at + fault.seconds, Action(inverse, names, None, options)))
            elif fault.seconds is not None and verb in ENDED_BY_ZERO:
                self._ends.append((fault.at + fault.seconds, Action(verb, names, 0.0)))
        return actions

    def _names(self, index: int, verb: str, candidates: Sequence[str], known: Sequence[str]) -> list[str]:
        who = self.faults[index].who
        if verb == "join":
            return [newcomer(self.faults[index], index)]
        if _means_all(verb, who):
            return list(candidates)
        return choose(who, candidates, known, stream(self.seed, "faults", index), f"faults[{index}].")
