"""Playing a case and hashing it: what every agent says in every tick, as it is heard by the scorer of any simulation.

The scorer listens anyway, so that nothing is delivered otherwise than in `covey simulate`.
"""

import gc
import string
from typing import NamedTuple

from agents.backend import Backend
from deploy.simulation import Simulation, rare_collections
from protocol.keys import order
from protocol.node import Event, messages_of
from tests.golden.cases import TICKS, Case
from tests.golden.fields import FIELDS, Values, address_of, digest, values_of

LETTERS = string.digits + string.ascii_letters + "-_"
SILENT = "."  # in place of the letter of an agent that said nothing in a tick
Said = dict[str, dict[str, list[Values]]]  # what the agents said in a tick: name -> field -> values, once for every message


class Record(NamedTuple):
    """A case as it is kept: one hash per tick, and for each tick one letter per field and one per agent."""

    ticks: list[str]
    fields: list[str]
    agents: list[str]


def play(case: Case, *, backend: Backend | None = None, tapped: bool = False, batches: bool = True) -> list[Said]:
    """What was said in each tick of a case; `tapped`: the bus is watched, as by the fuzzer; `batches` false: it delivers one by one."""
    said: list[Said] = [{} for _ in range(TICKS)]

    def hear(event: Event, now: float) -> None:
        for message in messages_of(event):
            found = values_of(message)
            if found:
                tick, name, incarnation = address_of(message)
                for field, values in found.items():
                    said[tick].setdefault(name, {}).setdefault(field, []).append([incarnation, *values])

    simulation = Simulation(case.scenario(), clock=case.clock, backend=backend, scores=False)  # type: ignore[arg-type]
    simulation.scorer.on_event = hear
    if tapped:
        simulation.bus.tap = lambda node, events: None
    simulation.bus.batches = batches
    with rare_collections():
        simulation.run()
    del simulation
    gc.collect()  # rare collections would keep the nodes of many cases
    return said


def record_of(said: list[Said]) -> Record:
    """The hashes of a played case."""
    names = sorted({name for tick in said for name in tick}, key=order)
    hashes = [{name: [digest(fields.get(field, [])).hex() for field in FIELDS] for name, fields in tick.items()} for tick in said]
    return Record(
        ticks=[digest([[name, tick[name]] for name in names if name in tick]).hex()[:8] for tick in hashes],
        fields=["".join(_letter([tick[name][place] for name in names if name in tick]) for place in range(len(FIELDS))) for tick in hashes],
        agents=["".join(_letter(tick[name]) if name in tick else SILENT for name in names) for tick in hashes],
    )


def names_in(said: list[Said]) -> list[str]:
    """The agents of a played case, in the order of `Record.agents`."""
    return sorted({name for tick in said for name in tick}, key=order)


def difference(kept: Record, said: list[Said]) -> str:
    """Where a played case leaves the kept one first, in words: tick, agents and fields; empty: nowhere."""
    now, names = record_of(said), names_in(said)
    tick = next((tick for tick in range(TICKS) if kept.ticks[tick] != now.ticks[tick]), None)
    if tick is None:
        return ""
    if not kept.fields:
        return f"tick {tick}"
    fields = [name for name, old, new in zip(FIELDS, kept.fields[tick], now.fields[tick]) if old != new]
    agents = [name for name, old, new in zip(names, kept.agents[tick], now.agents[tick]) if old != new]
    others = f" and {len(agents) - 1} more" if len(agents) > 1 else ""
    return f"tick {tick}, agent {agents[0] if agents else '?'}{others}, field {', '.join(fields) or '?'}"


def _letter(values: object) -> str:
    return LETTERS[digest(values)[0] % len(LETTERS)]
