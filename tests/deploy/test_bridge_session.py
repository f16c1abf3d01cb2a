"""A bridge whose session is half open (zenoh issue 2806) joins the run again; a death makes no such alarm."""

import asyncio
import contextlib
import json
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgpack
import pytest
import zenoh

from agents.agent import Agent
from agents.config import AgentConfig
from deploy.bridge import client
from deploy.bridge.bridge import Bridge
from deploy.bridge.client import Heard, Network, Participant
from deploy.bridge.settings import BridgeOptions
from deploy.bridge.watchdog import MOST_GUESTS, BridgeWatchdog
from deploy.scenario import resolve, toml_text
from protocol import live
from protocol.endpoints import free_port
from protocol.settings import NetworkSettings, RunSettings
from tests.protocol.test_split import LEASE, Proxy

TEAM = ("s1", "s2", "s3")


def hello(name: str, *heard: str) -> Heard:
    return Heard("hello", name, {"heard": list(heard)}, 1)


def reasons(watchdog: BridgeWatchdog, hellos: list[Heard], seconds: float, begin: float = 0.0) -> list[str]:
    """The reasons while these Hellos come every 2 s."""
    steps = range(int(seconds / 2.0))
    return [reason for step in steps for one in hellos if (reason := watchdog.take(one, begin + 2.0 * step))]


def test_an_agent_that_speaks_without_a_token_is_a_reason_to_join_again() -> None:
    watchdog, both = BridgeWatchdog(TEAM[:2], 5.0), [hello("s1", "s2"), hello("s2", "s1")]
    for name in ("s1", "s2"):
        watchdog.take(Heard("agent", name, {}, 1), 0.0)
    assert reasons(watchdog, both, 30.0) == []
    watchdog.take(Heard("agent", "s2", {}, 1, up=False), 30.0)
    assert reasons(watchdog, both, 10.0, 30.0) == ["s2 speaks, but its token has gone"]
    watchdog.take(Heard("agent", "s2", {}, 1), 40.0)
    assert reasons(watchdog, both, 60.0, 40.0) == []


def test_an_agent_that_the_others_hear_and_the_bridge_does_not_is_a_reason_and_a_dead_one_is_none() -> None:
    others = [hello("s1", "s2", "s3"), hello("s3", "s1", "s2")]
    assert reasons(BridgeWatchdog(TEAM, 5.0), others, 10.0) == ["the others hear s2, this session does not"]
    assert reasons(BridgeWatchdog(TEAM, 5.0), [hello("s1", "s3"), hello("s3", "s1")], 30.0) == [], "s2 is dead"
    minority = [hello("s1", "s2"), hello("s3", "s1"), hello("s4", "s1")]
    assert reasons(BridgeWatchdog((*TEAM, "s4"), 5.0), minority, 30.0) == [], "one of three lists s2"


def test_a_restart_under_the_same_name_is_no_reason_and_made_up_names_have_no_say() -> None:
    watchdog = BridgeWatchdog(TEAM, 5.0)
    for heard in (Heard("agent", "s2", {}, 1), Heard("agent", "s2", {}, 2), Heard("agent", "s2", {}, 1, up=False)):
        watchdog.take(heard, 0.0)
    assert reasons(watchdog, [hello("s2")], 30.0) == []
    assert reasons(BridgeWatchdog(TEAM, 5.0), [hello("s1"), *(hello(f"x{number}", "s2") for number in range(3))], 30.0) == []


def test_false_hellos_keep_no_bridge_busy() -> None:
    others = [hello("s1", "s2"), hello("s3", "s2")]
    assert len(reasons(BridgeWatchdog(TEAM, 5.0), others, 600.0)) == 5, "after 6 s, and 20, 40, 80 and 160 s later"


def test_where_links_may_be_silent_for_long_the_signs_must_last_as_long() -> None:
    others = [hello("s1", "s2", "s3"), hello("s3", "s1", "s2")]
    assert reasons(BridgeWatchdog(TEAM, 30.0), others, 30.0) == []
    assert reasons(BridgeWatchdog(TEAM, 30.0), others, 40.0) == ["the others hear s2, this session does not"]


def test_a_guest_counts_once_it_had_a_token_and_of_too_many_the_earliest_is_forgotten() -> None:
    watchdog = BridgeWatchdog((), 5.0)
    for name in ("s1", "s2"):
        watchdog.take(Heard("agent", name, {}, 1), 0.0)
    watchdog.take(Heard("agent", "s2", {}, 1, up=False), 0.0)
    assert reasons(watchdog, [hello("s1"), hello("s2")], 10.0) == ["s2 speaks, but its token has gone"]
    for number in range(MOST_GUESTS):
        watchdog.take(Heard("agent", f"x{number}", {}, 1), 10.0)
        watchdog.take(hello(f"x{number}", "s2"), 10.0)
        watchdog.take(Heard("agent", f"x{number}", {}, 1, up=False), 10.0)
        watchdog.take(hello(f"y{number}", "s2"), 10.0)
    assert "s1" not in watchdog._guests
    tables = [table for table in vars(watchdog).values() if isinstance(table, dict)]
    assert len(tables) == 6 and max(map(len, tables)) == MOST_GUESTS


def test_tokens_of_an_earlier_session_are_not_told_after_the_next_has_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zenoh's threads may hold a sample when a session is closed, also one of a session that was opened only in part."""
    callbacks: list[Callable[[Any], None]] = []

    class Session:
        def liveliness(self) -> "Session":
            return self

        def declare_subscriber(self, key: str, callback: Callable[[Any], None], history: bool) -> None:
            callbacks.append(callback)
            if len(callbacks) == 2:
                raise zenoh.ZError("not this time")

        def close(self) -> None:
            return

    monkeypatch.setattr(client.zenoh, "open", lambda config: Session())
    monkeypatch.setattr(client, "RETRY_SECONDS", 0.0)
    participant = Participant(Network(("tcp/127.0.0.1:1",)), "r", "s3")
    put = SimpleNamespace(key_expr="covey/r/alive/agent/s1/1", kind=zenoh.SampleKind.PUT)
    callbacks[0](put)
    participant._leave_and_join(Session(), [])
    participant._session = None
    participant._leave_and_join(Session(), [])
    for callback in callbacks:
        callback(put)
    told = [participant.events.get_nowait() for _ in range(participant.events.qsize())]
    assert len(callbacks) == 3 and [(one.name, one.up) for one in told] == [("s1", True), ("s1", False), ("s1", True)]


def heard_until(participant: Participant, condition: Callable[[list[Heard]], bool], say: Callable[[], None] = lambda: None) -> list[Heard]:
    """What a participant hears until that fulfils the condition."""
    found, end = list[Heard](), time.monotonic() + 20.0
    while not condition(found):
        assert time.monotonic() < end, found
        say()
        with contextlib.suppress(queue.Empty):
            found.append(participant.events.get(timeout=0.05))
    return found


@pytest.mark.live
def test_a_participant_that_joins_again_hears_speaks_and_has_tokens_as_before() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    other = live.open_session(NetworkSettings(listen=(endpoint,)))
    seen: list[tuple[str, bool]] = []
    ears: list[Any] = [
        other.declare_subscriber("covey/r/observation/s3", lambda sample: seen.append(("said", True))),
        other.liveliness().declare_subscriber("covey/r/alive/body/*/*", lambda sample: seen.append(("token", "PUT" in str(sample.kind)))),
    ]
    token = other.liveliness().declare_token("covey/r/alive/agent/s3/7")
    participant = Participant(Network((endpoint,)), "r", "s3")
    participant.listen("gossip/*")

    def speak() -> None:
        participant.appear(True)
        participant.say("observation", {})
        other.put("covey/r/gossip/s1", msgpack.packb({"wire": 2, "sender": "s1", "incarnation": 1}))

    def is_complete(found: list[Heard]) -> bool:
        return {"agent", "gossip"} <= {one.kind for one in found} and {("said", True), ("token", True)} <= set(seen)

    try:
        heard_until(participant, is_complete, speak)
        participant.rejoin()
        [*_, gone] = heard_until(participant, lambda found: any(not one.up and one.kind == "agent" for one in found))
        assert gone == Heard("agent", "s3", {}, 7, up=False)
        seen.clear()
        heard_until(participant, is_complete, speak)
    finally:
        del token, ears
        participant.close()
        other.close()


@pytest.fixture
def no_gossip_scouting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Peers meet by their seeds alone, so that every link leads through a proxy."""
    values, config_of = live.session_values, client.config_of

    def without(*arguments: Any) -> Any:
        config = config_of(*arguments)
        config.insert_json5("scouting/gossip/enabled", json.dumps(False))
        return config

    monkeypatch.setattr(live, "session_values", lambda settings: {**values(settings), "scouting/gossip/enabled": False})
    monkeypatch.setattr(client, "config_of", without)


@pytest.mark.live
@pytest.mark.slow
@pytest.mark.usefixtures("no_gossip_scouting")
@pytest.mark.parametrize(
    "redials",
    [pytest.param(False, id="nothing comes", marks=pytest.mark.nightly), pytest.param(True, id="words come, no token does")],
)
def test_a_bridge_whose_session_has_stayed_split_finds_the_agent_again(redials: bool, tmp_path: Path) -> None:
    """As in tests/protocol/test_split.py: the bridge of s1 and the agent s2 dial each other through proxies; s1 and s3 are whole."""
    ports = {name: free_port() for name in ("bridge", *TEAM)}
    to_bridge, to_agent = Proxy(ports["bridge"]), Proxy(ports["s2"])
    endpoints = {name: f"tcp/127.0.0.1:{port}" for name, port in ports.items()}
    seeds = {"bridge": (f"tcp/127.0.0.1:{to_agent.port}", endpoints["s1"], endpoints["s3"])}
    seeds |= {"s1": (endpoints["s3"],), "s2": (f"tcp/127.0.0.1:{to_bridge.port}", endpoints["s1"], endpoints["s3"]), "s3": ()}
    network = {"network.listen": [endpoints["bridge"]], "network.seeds": [*seeds["bridge"]], "network.lease": LEASE}
    options = {"run.name": f"t{ports['bridge']}", "team.composition": "", "run.clock": "realtime", "bodies.host": "own"}
    file = tmp_path / "run.toml"
    file.write_text(toml_text(resolve("quick", {**options, **{f"members.{name}": "A" for name in TEAM}, **network})))
    router_port = free_port()
    router = live.open_session(NetworkSettings(mode="router", listen=(f"tcp/127.0.0.1:{router_port}",)))
    bridge, over, heard_at = Bridge(BridgeOptions(file, "s1", router=f"tcp/127.0.0.1:{router_port}")), threading.Event(), dict[str, float]()
    take = bridge._on_heard

    def noted(heard: Heard) -> None:
        if heard.kind == "hello":
            heard_at[heard.name] = time.monotonic()
        take(heard)

    bridge._on_heard = noted  # type: ignore[method-assign]
    thread = threading.Thread(target=bridge.serve, args=(over,))
    thread.start()

    async def scene() -> None:
        config = AgentConfig(run=RunSettings(name=options["run.name"]), members=dict.fromkeys(TEAM, "A"))
        networks = {name: NetworkSettings(listen=(endpoints[name],), seeds=seeds[name], lease=LEASE) for name in TEAM}
        drivers = [live.Driver(Agent(config, name), networks[name]) for name in TEAM]
        tasks = [asyncio.create_task(driver.serve()) for driver in drivers]

        def sees(name: str) -> bool:
            return bool(bridge.body._alive.get(("agent", name)))

        def hears(name: str) -> bool:
            return time.monotonic() - heard_at.get(name, -9.0) < 1.0

        async def until(condition: Callable[[], bool], seconds: float) -> None:
            end = time.monotonic() + seconds
            while not condition():
                assert time.monotonic() < end, "not reached"
                await asyncio.sleep(0.02)

        await until(lambda: all(sees(name) and hears(name) for name in TEAM), 30.0)
        await asyncio.sleep(2.0)  # both have dialled
        to_bridge.refuses = to_agent.refuses = True
        to_agent.swallow("up", "down")  # the link that the bridge has dialled
        to_bridge.swallow("up")  # of the other link what s2 says
        await asyncio.sleep(0.75 * LEASE)
        to_bridge.swallow("down")
        await until(lambda: not sees("s2"), 4.0 * LEASE)
        to_agent.refuses = False  # the bridge may dial again, while s2 has not noticed
        began = time.monotonic()
        await asyncio.sleep(LEASE if redials else 0.0)
        to_bridge.refuses = not redials
        await until(lambda: all(sees(name) and hears(name) for name in TEAM), 60.0)
        print(f"together again after {time.monotonic() - began:.1f} s")
        for driver in drivers:
            driver.stop(0, "the test is over")
        await asyncio.gather(*tasks)

    try:
        asyncio.run(scene())
    finally:
        over.set()
        thread.join()
        bridge.close()
        router.close()
        for proxy in (to_bridge, to_agent):
            proxy.close()
