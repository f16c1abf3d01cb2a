"""Where the processes of a run find each other: the few that listen on a known port."""

import re
from collections.abc import Mapping, Sequence

from deploy.scenario import Scenario, world_names
from protocol.endpoints import free_port
from protocol.settings import BadSetting, NetworkSettings

SEED_AGENTS = 1  # agents that listen on a known port beside monitor and world, so that newcomers find the swarm when these are down


def seed_listeners(scenario: Scenario) -> dict[str, str]:
    """Which processes listen on a known port, and where: on free ports, or the monitor alone where the scenario says."""
    if scenario.network.mode == "router":
        raise BadSetting("network.mode = router: should be peer or client; the router of a run is its supervisor")
    listen = scenario.network.listen
    if len(listen) != 1:
        one = "should be one endpoint, such as ['tcp/127.0.0.1:0']: the supervisor listens there"
        raise BadSetting(f"network.listen = {list(listen)}: {one}")
    if listen != NetworkSettings().listen:  # any free port (0) has to be chosen here: the others dial it
        return {"monitor": re.sub(r":0$", lambda _: f":{free_port()}", listen[0])}
    if scenario.network.mode == "client":
        return {"monitor": f"tcp/127.0.0.1:{free_port()}"}
    names = ["monitor", world_names(scenario)[0], *list(scenario.members)[:SEED_AGENTS]]
    ports: set[int] = set()
    while len(ports) < len(names):
        ports.add(free_port())
    link = "tls" if scenario.network.encrypted else "tcp"
    return {name: f"{link}/127.0.0.1:{port}" for name, port in zip(names, sorted(ports))}


def endpoints(name: str, listens: Mapping[str, str], seeds: Sequence[str]) -> list[str]:
    """The endpoint options of a process: a seed listens on its known endpoint and does not dial it."""
    own = listens.get(name)
    words = ["--listen", own] if own else []
    for endpoint in seeds:
        words += ["--seed-endpoint", endpoint] if endpoint != own else []
    return words
