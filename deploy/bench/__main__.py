"""`covey bench`: figures of this machine, each beside a reference from the same run (docs/evidence/performance.md)."""

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import nullcontext

from cyclopts import App
from rich.console import Console

from deploy.bench.timing import BenchRow, table
from deploy.cli.errors import guarded
from protocol.settings import BadSetting

LONGEST = 86400.0  # s


def _round() -> Iterable[BenchRow]:
    from deploy.bench import rounds

    return rounds.measure()


def _codec() -> Iterable[BenchRow]:
    from deploy.bench import rounds

    return rounds.codec_rows()


def _simulate() -> Iterable[BenchRow]:
    from deploy.bench import simulations

    return simulations.simulate()


def _scale() -> Iterable[BenchRow]:
    from deploy.bench import simulations

    return simulations.scale()


def _start() -> Iterable[BenchRow]:
    from deploy.bench import processes

    return processes.start()


def _live() -> Iterable[BenchRow]:
    from deploy.bench import processes

    return processes.live()


def _realtime(seconds: float = 60.0) -> Iterable[BenchRow]:
    from deploy.bench import processes

    return processes.realtime(seconds=seconds)


def _tls() -> Iterable[BenchRow]:
    from deploy.bench import processes

    return processes.tls()


def _memory() -> Iterable[BenchRow]:
    return [{key: row[key] for key in ("agents", "spawn", "PSS, MB")} for row in _start()]


def _peers() -> Iterable[BenchRow]:
    from deploy.bench import peers

    return peers.measure()


def _page() -> Iterable[BenchRow]:
    from deploy.bench import pages

    return pages.measure()


def _replay() -> Iterable[BenchRow]:
    from deploy.bench import pages

    return pages.replay()


def _bodies() -> Iterable[BenchRow]:
    from deploy.bench import bodies

    return bodies.measure()


def _overload() -> Iterable[BenchRow]:
    from deploy.bench import overload

    return overload.measure()


BENCHES: dict[str, Callable[[], Iterable[BenchRow]]] = {
    "round": _round,
    "simulate": _simulate,
    "live": _live,
    "realtime": _realtime,
    "tls": _tls,
    "scale": _scale,
    "start": _start,
    "codec": _codec,
    "memory": _memory,
    "peers": _peers,
    "page": _page,
    "replay": _replay,
    "overload": _overload,
    "bodies": _bodies,
}


def bench(what: str, as_json: bool, seconds: float | None = None) -> int:
    """Run one benchmark or `all`; a table, and with --json one JSON object on the last line of standard output.

    `seconds`: for how long `realtime` runs each of its swarms.
    """
    if what not in BENCHES and what != "all":
        raise BadSetting(f"bench {what!r}: should be one of {', '.join(BENCHES)}, or all")
    if seconds is not None and (what != "realtime" or not 1.0 <= seconds <= LONGEST):
        raise BadSetting(f"--seconds {seconds:g}: is for `bench realtime`, from 1 to {LONGEST:g}")
    benches = {**BENCHES, "realtime": lambda: _realtime(seconds)} if seconds is not None else BENCHES
    found = {}
    for name in BENCHES if what == "all" else [what]:
        found[name] = _measure(name, benches[name])
        print(f"\n{name}\n{table(found[name])}", file=sys.stderr if as_json else sys.stdout, flush=True)
    if as_json:
        machine = {"cores": os.cpu_count(), "python": platform.python_version(), "machine": platform.machine(), "load": os.getloadavg()[0]}
        print(json.dumps({"machine": machine, **found}))
    return 0


def _measure(name: str, measured: Callable[[], Iterable[BenchRow]]) -> list[BenchRow]:
    """The rows of a benchmark; people see how many there are while they wait for the next."""
    console, begun, rows = Console(stderr=True), time.monotonic(), []
    with console.status(f"{name}: measuring") if console.is_terminal else nullcontext() as spinner:
        for row in measured():
            rows.append(row)
            if spinner is not None:
                spinner.update(f"{name}: {len(rows)} rows after {time.monotonic() - begun:.0f} s")
    return rows


def main() -> None:
    """Run `python -m deploy.bench WHAT [--json] [--seconds S]`, which is what `covey bench` runs."""
    app = App(name="covey bench", help_flags=[], version_flags=[])

    @app.default
    def command(what: str, /, *, json: bool = False, seconds: float | None = None) -> int:
        return bench(what, json, seconds)

    sys.exit(guarded(lambda: app(exit_on_error=False, print_error=False, result_action="return_value") or 0))


if __name__ == "__main__":
    main()
