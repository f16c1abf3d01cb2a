"""`check`: is the scenario right, and can this machine run it?"""

import os
import sys

from deploy.scenario import Scenario
from deploy.swarm.rundir import runs_folder, versions
from protocol.endpoints import check_endpoints
from protocol.live import open_session
from protocol.settings import NetworkSettings

AGENTS_PER_CORE = 24  # in real time with 4 ticks a second


def check(scenario: Scenario) -> int:
    """Say what the scenario comes to and whether this machine can open a session; raises BadSetting where not."""
    check_endpoints(scenario.network)
    classes = list(scenario.members.values())
    team = ", ".join(f"{classes.count(name)} {name}" for name in dict.fromkeys(classes))
    run = scenario.run
    print(f"scenario   {run.scenario} is right: {len(classes)} agents ({team})")
    print(f"           {scenario.targets.count} targets, {run.ticks} ticks of {run.dt:g} s")
    found = versions()
    print(f"machine    Python {found['python']}, {found['cores']} cores, {found['machine']}")
    open_session(NetworkSettings()).close()
    print(f"network    a Zenoh {found['packages']['eclipse-zenoh']} session opens on 127.0.0.1")
    folder = next(path for path in [runs_folder(), *runs_folder().parents] if path.exists())
    print(f"runs       {runs_folder()}: {'writable' if os.access(folder, os.W_OK) else 'NOT writable; set COVEY_RUNS'}")
    if len(classes) > AGENTS_PER_CORE * (os.cpu_count() or 1) and run.clock == "realtime":
        print(f"warning    {len(classes)} agents on {os.cpu_count()} cores will be late in real time; use --lockstep", file=sys.stderr)
    return 0 if os.access(folder, os.W_OK) else 2
