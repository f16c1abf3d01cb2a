"""The faults of a scenario played on names alone, before any process: which cannot be carried out, and which change nothing.

Numbers and shares are drawn as in the run. Agents that die by themselves are not foreseen.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from deploy.faults.faults import LINK_VERBS, MOST_NAMED, REFUSED, Action, Schedule
from deploy.faults.links import other_side
from deploy.scenario import Scenario, world_names

NO_EFFECT_ON = {
    "kill": "dead",
    "restart": "alive",
    "pause": "dead or paused",
    "resume": "not paused",
}  # verb -> the agents that it does not change

ZERO_ENDS_FAULT = ("starve", "throttle")  # verbs whose small values do more, but whose 0 ends them


class FaultFinding(NamedTuple):
    """What is found about a fault; one that cannot be carried out is refused."""

    text: str
    is_refused: bool


def rehearse(scenario: Scenario) -> list[FaultFinding]:
    """What is found about faults that are valid one by one (`check_faults`), in the order in which they come."""
    schedule, state = Schedule(scenario.run.seed, scenario.faults), _State(scenario)
    return [finding for time in _times(scenario) for action in state.due(schedule, time) for finding in state.play(action, time)]


class _State:
    """Who lives and who is paused. The living stand in the order in which a simulation draws from them."""

    def __init__(self, scenario: Scenario) -> None:
        self._members = list(scenario.members)  # and newcomers
        self._world = world_names(scenario)
        self._living = dict.fromkeys([*self._members, *self._world])
        self._paused: set[str] = set()
        self._begun: set[str] = set()  # verbs that have come, those of links since all were healed

    def due(self, schedule: Schedule, time: float) -> list[Action]:
        """The actions of a tick, which are all drawn before the first of them."""
        alive = [name for name in self._living if name not in self._world]
        dead = [name for name in self._members if name not in self._living]
        return schedule.due(time, alive, dead, [*alive, *dead, *self._world])

    def play(self, action: Action, time: float) -> Iterator[FaultFinding]:
        """Carry out an action, and say what it does not change."""
        verb, names = action.verb, action.names
        if verb == REFUSED:
            yield FaultFinding(f"{action.options['why']} at {time:g} s", True)
        elif not names and verb not in ("freeze", "heal"):
            yield FaultFinding(f"{verb} at {time:g} s strikes nobody", False)
        elif verb == "partition" and not other_side(names, self._members, str(action.options.get("kind"))):
            yield FaultFinding(f"partition at {time:g} s cuts nothing: nobody is on the other side", False)
        elif verb == "heal" and not action.options.get("only_cut") and self._begun.isdisjoint(LINK_VERBS):
            yield FaultFinding(f"heal at {time:g} s changes nothing: all links are clear", False)
        elif verb in ZERO_ENDS_FAULT and action.value == 0.0 and verb not in self._begun:
            yield FaultFinding(f"{verb} at {time:g} s changes nothing: value = 0 only ends an earlier one", False)
        elif verb not in LINK_VERBS and (idle := [name for name in names if self._is_idle(verb, name)]):
            yield FaultFinding(f"{verb} at {time:g} s changes nothing for {_listed(idle)}: {NO_EFFECT_ON.get(verb, 'dead')}", False)
        self._begun.add(verb)
        if verb == "heal" and not action.options.get("only_cut"):
            self._begun.difference_update(LINK_VERBS)
        for name in names:
            self._change(verb, name)

    def _is_idle(self, verb: str, name: str) -> bool:
        match verb:
            case "restart":
                return name in self._living
            case "resume":
                return name not in self._paused
            case "pause":
                return name not in self._living or name in self._paused
        return verb not in ("join", "freeze") and name not in self._living

    def _change(self, verb: str, name: str) -> None:
        match verb:
            case "kill":
                self._living.pop(name, None)
                self._paused.discard(name)
            case "restart" | "join":
                self._living.setdefault(name)
            case "twin" if name in self._living:  # the older one leaves
                del self._living[name]
                self._living[name] = None
            case "pause" if name in self._living:
                self._paused.add(name)
            case "resume":
                self._paused.discard(name)
        if verb == "join" and name not in self._members:
            self._members.append(name)


def _times(scenario: Scenario) -> list[float]:
    """The times of the ticks at which faults begin or end, s."""
    moments = {moment for fault in scenario.faults for moment in (fault.at, fault.at + (fault.seconds or 0.0))}
    times = {_tick(moment, scenario.run.dt) * scenario.run.dt for moment in moments}
    return sorted(time for time in times if time <= (scenario.run.ticks - 1) * scenario.run.dt)


def _tick(moment: float, dt: float) -> int:
    """The first tick that is not before a moment, s."""
    tick = max(0, math.ceil(moment / dt) - 1)
    while tick * dt < moment:
        tick += 1
    return tick


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more
