"""`covey bench`: figures of this machine, each beside a reference from the same run (docs/performance.md)."""

import json
import os
import platform
import sys
from collections.abc import Callable

from deploy.bench.timing import Row, table
from protocol.settings import BadSetting


def _round() -> list[Row]:
    from deploy.bench import rounds

    return rounds.measure()


def _codec() -> list[Row]:
    from deploy.bench import rounds

    return rounds.codec_rows()


def _simulate() -> list[Row]:
    from deploy.bench import simulations

    return simulations.simulate()


def _scale() -> list[Row]:
    from deploy.bench import simulations

    return simulations.scale()


def _start() -> list[Row]:
    from deploy.bench import processes

    return processes.start()


def _live() -> list[Row]:
    from deploy.bench import processes

    return processes.live()


def _realtime() -> list[Row]:
    from deploy.bench import processes

    return processes.realtime()


def _memory() -> list[Row]:
    return [{key: row[key] for key in ("agents", "spawn", "PSS, MB")} for row in _start()]


def _peers() -> list[Row]:
    from deploy.bench import peers

    return peers.measure()


def _page() -> list[Row]:
    from deploy.bench import pages

    return pages.measure()


def _replay() -> list[Row]:
    from deploy.bench import pages

    return pages.replay()


BENCHES: dict[str, Callable[[], list[Row]]] = {
    "round": _round,
    "simulate": _simulate,
    "live": _live,
    "realtime": _realtime,
    "scale": _scale,
    "start": _start,
    "codec": _codec,
    "memory": _memory,
    "peers": _peers,
    "page": _page,
    "replay": _replay,
}


def bench(what: str, as_json: bool) -> int:
    """Run one benchmark or `all`; a table, and with --json one JSON object on the last line of standard output."""
    if what not in BENCHES and what != "all":
        raise BadSetting(f"bench {what!r}: should be one of {', '.join(BENCHES)}, or all")
    found = {}
    for name in BENCHES if what == "all" else [what]:
        found[name] = BENCHES[name]()
        print(f"\n{name}\n{table(found[name])}", file=sys.stderr if as_json else sys.stdout, flush=True)
    if as_json:
        machine = {"cores": os.cpu_count(), "python": platform.python_version(), "machine": platform.machine(), "load": os.getloadavg()[0]}
        print(json.dumps({"machine": machine, **found}))
    return 0
