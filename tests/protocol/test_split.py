"""The split of zenoh issue 2806, made for real: two peers that dial each other, links that die silently, and one who notices first.

Each dials the other through a proxy that can swallow bytes. The one who notices closes both links and dials again while the other still
holds its own link alive; the new link is added to the other's old session, which never says its tokens again.
"""

import asyncio
import socket
import threading
import time

import pytest

from agents.agent import Agent
from agents.config import AgentConfig
from deploy.scenario import resolve, world_config
from deploy.scoring.scorer import Scorer
from protocol import live
from protocol.endpoints import free_port
from protocol.settings import NetworkSettings, RunSettings
from tests.protocol.test_live import until
from world.body import Body

pytestmark = [pytest.mark.live, pytest.mark.slow]
LEASE = 4.0  # s
SOME = {("s1", False), ("body", True)}  # of the cases, for continuous integration


class Proxy:
    """A port of 127.0.0.1 that leads to another; each direction of the connections made so far can be made to swallow everything."""

    def __init__(self, target: int) -> None:
        self._target, self.refuses = target, False
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._flows: list[dict[str, bool]] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def swallow(self, *directions: str) -> None:
        """Lose what goes "up", from who has dialled, or "down"; the end of the connection too."""
        for flow in self._flows:
            flow.update(dict.fromkeys(directions, False))

    def close(self) -> None:
        self._server.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self._target)) if not self.refuses else None
            except OSError:
                if self._server.fileno() < 0:
                    return
                far = None
            if far is None:
                near.close()
                continue
            flow = {"up": True, "down": True}
            self._flows.append(flow)
            for source, sink, direction in ((near, far, "up"), (far, near, "down")):
                threading.Thread(target=self._carry, args=(source, sink, flow, direction), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket, flow: dict[str, bool], direction: str) -> None:
        try:
            while data := source.recv(1 << 16):
                if flow[direction]:
                    sink.sendall(data)
            if flow[direction]:
                sink.shutdown(socket.SHUT_WR)
        except OSError:
            pass


@pytest.mark.parametrize(
    ("first", "redials"),
    [
        pytest.param(first, redials, id=f"{first}, {what}", marks=() if (first, redials) in SOME else pytest.mark.nightly)
        for first in ("s1", "monitor", "body")
        for redials, what in ((False, "nothing comes"), (True, "words come, no token does"))
    ],
)
def test_two_whose_session_has_stayed_split_find_each_other_again(first: str, redials: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """If s2 dials again as well words pass in both directions, but its token stays lost; else nothing passes, and s3 tells.

    `first`: an agent, an observer, or the body of s2, who says no Hello.
    """

    async def scene() -> None:
        members = dict.fromkeys(("s1", "s2", "s3"), "A")
        config = AgentConfig(run=RunSettings(name=f"t{free_port()}"), members=members)
        options = {"team.composition": "", "members.s2": "A", "members.s3": "A", "bodies.host": "own", "run.clock": "realtime"}
        scenario = resolve("quick", {"run.name": config.run.name, **options})
        agents = [Agent(config, name) for name in config.members]
        listener = {"s1": agents[0], "monitor": Scorer(scenario), "body": Body(world_config(scenario), "s2", 1)}[first]
        nodes, ports = [listener, *agents[1:]], [free_port() for _ in range(3)]
        towards = [Proxy(ports[0]), Proxy(ports[1])]
        witness, dialled = f"tcp/127.0.0.1:{ports[2]}", [f"tcp/127.0.0.1:{proxy.port}" for proxy in towards[::-1]]
        seeds = [(dialled[0], witness), (dialled[1], witness), ()]
        networks = [NetworkSettings(listen=(f"tcp/127.0.0.1:{port}",), seeds=dial, lease=LEASE) for port, dial in zip(ports, seeds)]
        values = live.session_values
        monkeypatch.setattr(live, "session_values", lambda settings: {**values(settings), "scouting/gossip/enabled": False})
        drivers = [live.Driver(node, network) for node, network in zip(nodes, networks)]
        tasks = [asyncio.create_task(driver.serve()) for driver in drivers]

        def sees(one: int, other: int) -> bool:
            node, name = nodes[one], f"s{other + 1}"
            if isinstance(node, Agent):
                return not isinstance(nodes[other], Agent) or ((peer := node.peer_table.peers.get(name)) is not None and peer.token)
            return name in node.alive() if isinstance(node, Scorer) else node._presence.live(name) is not None

        def hears(one: int, other: int) -> bool:
            node, name = nodes[one], f"s{other + 1}"
            if isinstance(node, Agent):
                heard = node.membership.session_watchdog.heard(asyncio.get_running_loop().time())
                return not isinstance(nodes[other], Agent) or name in heard
            return name in (node.greeted if isinstance(node, Scorer) else node._presence.hellos)

        await until(lambda: all(sees(one, other) and hears(one, other) for one in range(3) for other in range(3) if one != other))
        await asyncio.sleep(2.0)  # both have dialled
        towards[0].refuses = towards[1].refuses = True
        towards[1].swallow("up", "down")  # the link that the first has dialled
        towards[0].swallow("up")  # of the other link what s2 says
        await asyncio.sleep(0.75 * LEASE)
        towards[0].swallow("down")
        await until(lambda: not sees(0, 1), 4.0 * LEASE)
        towards[1].refuses = False  # the first may dial again, while s2 has not noticed
        split, began = sees(1, 0), time.monotonic()
        await asyncio.sleep(LEASE if redials else 0.0)
        towards[0].refuses = not redials
        await until(lambda: sees(0, 1) and sees(1, 0) and hears(0, 1) and hears(1, 0), 60.0)
        reopened = [driver.counts["reopened"] for driver in drivers]
        print(f"s2 had not noticed: {split}; together again after {time.monotonic() - began:.1f} s, sessions opened anew: {reopened}")
        for driver in drivers:
            driver.stop(0, "the test is over")
        await asyncio.gather(*tasks)
        for proxy in towards:
            proxy.close()
        assert not split or 1 <= reopened[0] + reopened[1] <= 2
        assert reopened[2] == 0

    asyncio.run(scene())
