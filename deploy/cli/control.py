"""`kill`, `pause`, `resume`, `restart`, `partition`, `heal`, `drop`, `delay` and `down`: requests to the supervisor of a running swarm."""

import sys
import time
from typing import Any

from deploy.live.control import ControlClient
from deploy.storage.run_directory import RunDirectory, find_running
from protocol.settings import BadSetting

QUIET_SECONDS = 5.0  # s after which `down` says what it waits for


def selection(verb: str, names: tuple[str, ...], random: int | None, otherwise: str | None) -> str:
    """The selected agents as one text: names, a share or a number; `otherwise` without any of these. Raises BadSetting."""
    if not all(map(str.strip, names)):
        raise BadSetting(f"{verb}: a name is empty; should be names such as s3, a number such as 4, or a share such as 30%")
    if not names and random is None and otherwise is None:
        raise BadSetting(f"{verb}: nobody is named; give names such as s3, a number such as 4, or a share such as 30%")
    if random is not None and random < 1:
        raise BadSetting(f"--random {random}: should be 1 or more")
    if random is not None and names:
        raise BadSetting(f"--random {random}: draws agents; {' '.join(names)} names them: give one of both")
    drawn = [name for name in names if name.isdecimal() or name.endswith("%")]
    if drawn and len(names) > 1:
        raise BadSetting(f"{' '.join(names)}: should be names, or one number or share such as {drawn[0]}")
    return str(random) if random is not None else ",".join(names) or str(otherwise)


def send(verb: str, who: str, run: str | None, value: float | None = None, options: dict[str, Any] | None = None) -> int:
    """Send a request to the supervisor of a run and print its answer."""
    client = ControlClient(find_running(run, supervised=True))
    print(client.ask(verb, who, value, options)["ok"])
    return 0


def down(run: str | None) -> int:
    """End a run and wait until it has ended: as long as its supervisor lives, which may compute for minutes after a long run."""
    directory = find_running(run, supervised=True)
    ControlClient(directory).ask("down")
    asked, said = time.monotonic(), ""
    while directory.is_running():
        doing = _doing(directory)
        if doing != said and time.monotonic() > asked + QUIET_SECONDS:
            said = doing
            hint = "Ctrl-C ends this wait, and the run ends by itself"
            print(f"covey: run {directory.name} still {doing}; {hint}", file=sys.stderr, flush=True)
        time.sleep(0.05)
    print(f"run {directory.name} is down")
    return 0


def _doing(directory: RunDirectory) -> str:
    """What a run that ends is busy with, by the files that it has written."""
    if directory.result.exists():
        return "ends its processes"
    return "computes the scores of its tracks" if directory.scores.exists() else "scores its last ticks"
