"""The links of a whole swarm: what the link verbs of `deploy.faults.faults` do to every direction between two nodes.

In a simulation `Links` lies between the nodes of the virtual bus; live, the supervisor tells every agent its own `reception`. Faults
without names in them touch the links between agents only: the world and the monitor are reached through them by name.
"""

from collections.abc import Collection, Iterable, Sequence

import msgspec

from deploy.faults.faults import Action
from protocol.link_faults import CLEAR, IncomingLinks, LinkCondition, LinkConditions

OWN = {"drop": ("burst",), "delay": ("jitter",), "throttle": ("queue",)}  # options of one verb alone, which end with it
SPREADING = {"duplicate", "reorder"}  # verbs that share the option `spread`, which ends with the last of them
CUTS = {"both": "cut off", "one-way": "none of the rest hears", "bridge": "cut off but for one bridge:"}

Direction = tuple[str, str]  # sender, receiver


class Links:
    """The state of all links; `act` changes it, `carry` lives by it."""

    def __init__(self, seed: int, names: Sequence[str]) -> None:
        self._seed = seed
        self._names = list(names)
        self._cut: set[Direction] = set()
        self._torn: set[Direction] = set()  # cut, and the session goes with it
        self._conditions: dict[Direction, LinkCondition] = {}
        self._ears: dict[str, IncomingLinks] = {}

    def add(self, name: str) -> None:
        """A newcomer, whose links are clear."""
        if name not in self._names:
            self._names.append(name)

    def act(self, action: Action, living: Collection[str] | None = None) -> None:
        """Carry out a link verb. `living`: the agents of which one can be a bridge, not paused; None: all."""
        if action.verb == "heal" and action.options.get("only_cut"):
            ended = set(self._around(action.names))
            self._cut, self._torn = self._cut - ended, self._torn - ended
        elif action.verb == "heal":
            self._cut, self._torn, self._conditions = set(), set(), {}
        elif action.verb == "partition":
            cut = self._partition(action.names, str(action.options.get("kind", "both")), living)
            self._cut |= cut
            self._torn |= cut if action.options.get("tokens", True) else set()
        else:
            self._spoil(action)
        for name in {*self._ears, *self._receivers()}:
            self._ears.setdefault(name, IncomingLinks(self._seed, name)).set(self.reception(name))

    def reception(self, receiver: str) -> LinkConditions:
        """How one node hears the others."""
        cut = tuple(sorted(sender for sender, hearer in self._cut if hearer == receiver))
        conditions = {sender: found for (sender, hearer), found in self._conditions.items() if hearer == receiver}
        return LinkConditions(cut=cut, conditions=conditions)

    def torn(self, one: str, other: str) -> bool:
        """Whether the session between two nodes has been cut; one direction is enough."""
        return (one, other) in self._torn or (other, one) in self._torn

    def sides(self, names: Iterable[str]) -> int:
        """The number of groups into which cuts divide some nodes; no message goes from one group to another in either direction."""
        apart = self._cut & {(receiver, sender) for sender, receiver in self._cut}
        rest, found = set(names), 0
        while rest:
            reached, found = [rest.pop()], found + 1
            for one in reached:
                heard = {other for other in rest if (one, other) not in apart}
                reached.extend(heard)
                rest -= heard
        return found

    def carry(self, sender: str, receiver: str, key: str, payload: bytes, now: float) -> Sequence[tuple[float, bytes]]:
        """(delay s, payload) of every copy that arrives (`protocol.virtual.Link`)."""
        ears = self._ears.get(receiver)
        return ears.hear(sender, payload, now) if ears else [(0.0, payload)]

    def _partition(self, names: Sequence[str], kind: str, living: Collection[str] | None) -> set[Direction]:
        """The directions that are cut between those meant and the rest."""
        cut = {(sender, receiver) for sender in names for receiver in other_side(names, self._names, kind, living)}
        return cut if kind == "one-way" else cut | {(receiver, sender) for sender, receiver in cut}

    def describe(self, action: Action) -> str:
        """What a link verb has done, in one line."""
        who = ", ".join(action.names)
        if action.verb == "heal":
            return f"{who or 'nobody'}: no longer cut off" if action.options.get("only_cut") else "all links are clear again"
        if not who:
            return f"nobody to {action.verb}"
        if action.verb == "partition":
            kind = str(action.options.get("kind", "both"))
            if not other_side(action.names, self._names, kind):
                return f"nobody is on the other side of a cut around {who}"
            return f"{CUTS[kind]} {who}"
        value = action.value or 0.0
        amounts = {"delay": f"{value:g} s", "throttle": f"to {value:g} kbit/s" if value else "no more"}
        return f"{action.verb} {amounts.get(action.verb, f'{100.0 * value:g} % of the messages')} from and to {who}"

    def _spoil(self, action: Action) -> None:
        """Set the condition of every link from or to those meant."""
        changes: dict[str, float] = {name: getattr(CLEAR, name) for name in OWN.get(action.verb, ())}
        changes.update({name: float(value) for name, value in action.options.items()})
        changes[action.verb] = action.value or 0.0
        for direction in self._around(action.names):
            before = self._conditions.get(direction, CLEAR)
            spread = before.spread if any(getattr(before, verb) for verb in SPREADING - {action.verb}) else CLEAR.spread
            changed = msgspec.structs.replace(before, **{"spread": spread, **changes})
            if msgspec.structs.replace(changed, burst=0.0, spread=CLEAR.spread, queue=CLEAR.queue) == CLEAR:
                self._conditions.pop(direction, None)
            else:
                self._conditions[direction] = changed

    def _around(self, names: Iterable[str]) -> list[Direction]:
        pairs = {pair for name in names for other in self._names if other != name for pair in ((name, other), (other, name))}
        return sorted(pairs)

    def _receivers(self) -> set[str]:
        return {receiver for _, receiver in {*self._cut, *self._conditions}}


def other_side(names: Sequence[str], team: Sequence[str], kind: str, living: Collection[str] | None = None) -> list[str]:
    """The agents of a team from whom a cut divides `names`; of a bridge the first of the rest that lives hears both sides."""
    rest = [name for name in team if name not in names]
    if kind != "bridge":
        return rest
    alive = [name for name in rest if living is None or name in living]
    return [name for name in rest if name != (alive or rest)[0]]
