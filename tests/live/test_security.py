"""A swarm with certificates: who has none, one of a foreign authority, or that of another name is neither heard nor told."""

import asyncio
import contextlib
import json
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import zenoh

from deploy.live.certificates import make_keys
from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol import codec, keys, live
from protocol.endpoints import free_port
from protocol.message import Message
from protocol.messages import Command, Gossip, Hello
from protocol.node import Alive, Effect, Event, Node, Received, Rejected, Started, Subscribe, messages_of
from protocol.observer_messages import Truth
from protocol.settings import BadSetting, NetworkSettings
from tests.live.harness import Covey

pytestmark = pytest.mark.live
YOUNG = 2**62  # an incarnation that would win against all others
RUN = "covey"
OWN = keys.one_of(RUN, "estimate", "s1")  # what the insider may write, though it is rubbish


class Eavesdropper(Node):
    """A watcher with a certificate that keeps whatever is forged, and the insider's rubbish."""

    run, role, name, incarnation = RUN, "monitor", "eavesdropper", 1

    def __init__(self) -> None:
        self.honest = 0
        self.own: list[Event] = []
        self.forged: list[Event] = []

    def handle(self, event: Event, now: float) -> list[Effect]:
        if isinstance(event, Started):
            return [Subscribe(f"{keys.ROOT}/{RUN}/**")]
        honest = [message for message in messages_of(event) if message.incarnation < YOUNG]
        self.honest += len(honest)
        if honest and len(honest) == len(messages_of(event)):
            return []
        if isinstance(event, Rejected) and event.key == OWN:
            self.own.append(event)
        elif isinstance(event, Received | Rejected) or (isinstance(event, Alive) and event.incarnation >= YOUNG):
            self.forged.append(event)
        return []

    def deadline(self) -> float | None:
        return None


def forgeries() -> Iterator[tuple[str, bytes]]:
    """What would do harm if anybody heard it: messages of a younger s2 and a younger world, and rubbish under all keys of s2."""
    place = {"pose": (1.0, 1.0, 0.0), "cod": (1.0, 1.0), "power_radius": 1.0, "unused": 3.2}
    messages: list[Message] = [
        Hello(sender="s2", incarnation=YOUNG),
        Gossip(sender="s2", incarnation=YOUNG, tick=1, **place),  # type: ignore[arg-type]
        Command(sender="s2", incarnation=YOUNG, tick=1, velocity=(1.0, 0.0), turn_rate=0.0),
        Hello(sender="world", incarnation=YOUNG, role="world"),
        Truth(sender="world", incarnation=YOUNG, tick=1, time=0.0),
    ]
    yield from ((keys.message_key(RUN, message), codec.encode(message)) for message in messages)
    yield from ((keys.one_of(RUN, kind, "s2"), b"\xc1") for kind in ("hello", "gossip", "observation", "command", "estimate"))


class Stranger:
    """A session that says what it must not and listens to everything."""

    def __init__(self, config: zenoh.Config) -> None:
        self.heard: list[str] = []
        self._session = zenoh.open(config)
        liveliness = self._session.liveliness()
        token = liveliness.declare_token(keys.token_key(RUN, "agent", "s2", YOUNG))
        remote = zenoh.Locality.REMOTE
        ears = [self._session.declare_subscriber(key, self._hear, allowed_origin=remote) for key in ("**", f"{keys.ROOT}/{RUN}/truth")]
        self._declared = [token, *ears]

    def _hear(self, sample: zenoh.Sample) -> None:
        self.heard.append(str(sample.key_expr))

    def forge(self) -> None:
        for key, payload in forgeries():
            self._session.put(key, payload)

    def say_own(self) -> None:
        self._session.put(OWN, b"\xc1")

    def close(self) -> None:
        self._session.close()


def with_keys(folder: Path) -> dict[str, str]:
    return {"ca": str(folder / "ca.pem"), "certificate": str(folder / "{name}.pem"), "key": str(folder / "{name}.key")}


def stranger_config(seeds: tuple[str, ...], files: dict[str, str], name: str) -> zenoh.Config:
    """A peer with these certificates that keeps to no access control of its own."""
    settings = NetworkSettings(seeds=seeds, **files)  # type: ignore[arg-type]
    config = live.session_config(settings, keys.Token(RUN, "agent", name, YOUNG))
    config.insert_json5("access_control", json.dumps({"enabled": False}))
    return config


def without_certificate(seeds: tuple[str, ...], folder: Path) -> zenoh.Config:
    """A peer that knows the authority, as everybody may, and has nothing of its own to show."""
    config = live.session_config(NetworkSettings(listen=(f"tcp/127.0.0.1:{free_port()}",), seeds=seeds))
    config.insert_json5("transport/link/tls", json.dumps({"root_ca_certificate": str(folder / "ca.pem"), "verify_name_on_connect": False}))
    return config


def plain(seeds: tuple[str, ...]) -> zenoh.Config:
    """A peer that has not heard of TLS."""
    return live.session_config(NetworkSettings(seeds=tuple(seed.replace("tls/", "tcp/") for seed in seeds)))


async def until_there(file: Path) -> NetworkSettings:
    """The network settings of a run, once they are written."""
    async with asyncio.timeout(60.0):
        while True:
            with contextlib.suppress(OSError, KeyError, tomllib.TOMLDecodeError):
                return msgspec.convert(tomllib.loads(file.read_text())["network"], NetworkSettings)
            await asyncio.sleep(0.02)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nothing_that_a_stranger_or_an_insider_forges_is_delivered_and_strangers_hear_nothing(covey: Covey) -> None:
    assert covey.run("keys", "--scenario", "quick", "--into", "ours")[0] == 0
    make_keys(["s2"], covey.folder / "theirs")
    supervisor = covey.start("up", "quick", "--run", RUN, "--keys", "ours", "--lockstep", "--json", "--seconds", "20")
    eavesdropper = Eavesdropper()

    async def scene() -> dict[str, Stranger]:
        network = await until_there(covey.folder / "runs" / "latest" / "run.toml")
        assert all(seed.startswith("tls/127.0.0.1:") for seed in network.seeds)
        watcher = live.Driver(eavesdropper, network)
        watching = asyncio.create_task(watcher.serve())
        configs = {
            "plain": plain(network.seeds),
            "without": without_certificate(network.seeds, covey.folder / "ours"),
            "foreign": stranger_config(network.seeds, with_keys(covey.folder / "theirs"), "s2"),
            "insider": stranger_config(network.seeds, with_keys(covey.folder / "ours"), "s1"),
        }
        strangers = {name: await asyncio.to_thread(Stranger, config) for name, config in configs.items()}
        try:
            while supervisor.poll() is None:
                for stranger in strangers.values():
                    stranger.forge()
                strangers["insider"].say_own()
                await asyncio.sleep(0.05)
        finally:  # an open session would hold up the end of the tests
            for stranger in strangers.values():
                await asyncio.to_thread(stranger.close)
            watcher.stop(0, "the run is over")
            await watching
        return strangers

    strangers = asyncio.run(scene())
    assert supervisor.stdout is not None and supervisor.stderr is not None
    output, complaints = supervisor.stdout.read(), supervisor.stderr.read()
    assert supervisor.returncode == 0, complaints
    assert eavesdropper.honest > 100, "the watcher has a certificate"
    assert eavesdropper.own, "the insider's links work: what it may write is heard"
    assert eavesdropper.forged == []
    for name in ("plain", "without", "foreign"):
        assert strangers[name].heard == [], name
    assert not [key for key in strangers["insider"].heard if key.split("/")[2] == "truth"]
    of_one = ("observation", "command", "estimate")
    assert not [key for key in strangers["insider"].heard if key.split("/")[2] in of_one and not key.endswith("/s1")]
    result = json.loads(output.splitlines()[-1])
    simulated = Simulation(resolve("quick", {"run.seconds": 20.0})).run()
    assert result["transcript"] == simulated.transcript
    assert result["ticks"] == simulated.ticks
    for log in (covey.folder / "runs" / "latest" / "logs").glob("s[1-6].jsonl"):
        assert '"rejected"' not in log.read_text() and '"error"' not in log.read_text(), log


@pytest.mark.slow
def test_a_seed_with_a_foreign_certificate_learns_nothing_from_those_who_dial_it(tmp_path: Path) -> None:
    make_keys(["s1", "s2"], tmp_path / "ours")
    make_keys(["s1"], tmp_path / "theirs")

    async def scene(folder: Path) -> list[str]:
        endpoint = f"tls/127.0.0.1:{free_port()}"
        settings = NetworkSettings(listen=(endpoint,), admit=("s1", "s2"), **with_keys(folder))  # type: ignore[arg-type]
        listener = Stranger(live.session_config(settings, keys.Token(RUN, "agent", "s1", 1)))
        mine = NetworkSettings(seeds=(endpoint,), admit=("s1", "s2"), **with_keys(tmp_path / "ours"))  # type: ignore[arg-type]
        dialler = await asyncio.to_thread(live.open_session, mine, keys.Token(RUN, "agent", "s2", 1))
        hello = keys.one_of(RUN, "hello", "s2")
        ear = listener._session.declare_subscriber(keys.all_of(RUN, "hello"), listener._hear, allowed_origin=zenoh.Locality.REMOTE)
        for _ in range(60):  # 3 s: a refused seed is dialled again and again
            dialler.put(hello, b"secret")
            await asyncio.sleep(0.05)
            if listener.heard:
                break
        await asyncio.to_thread(dialler.close)
        ear.undeclare()
        listener.close()
        return listener.heard

    assert asyncio.run(scene(tmp_path / "theirs")) == []
    assert set(asyncio.run(scene(tmp_path / "ours"))) == {keys.one_of(RUN, "hello", "s2")}


def peer(folder: Path, name: str, *, listen: str = "", dial: str = "", admit: tuple[str, ...] = ("s1", "s2", "s3")) -> zenoh.Session:
    """A session of an agent with its certificate of this folder; blocks."""
    places = {"listen": (listen,)} if listen else {"seeds": (dial,)}
    settings = NetworkSettings(admit=admit, **places, **with_keys(folder))  # type: ignore[arg-type]
    return live.open_session(settings, keys.Token(RUN, "agent", name, 1))


class Ear:
    """A session that notes the names whose Hellos it hears."""

    def __init__(self, session: zenoh.Session) -> None:
        self.heard: set[str] = set()
        self._session = session
        expression, remote = keys.all_of(RUN, "hello"), zenoh.Locality.REMOTE
        self._subscriber = session.declare_subscriber(expression, self._hear, allowed_origin=remote)

    def _hear(self, sample: zenoh.Sample) -> None:
        self.heard.add(str(sample.key_expr).rpartition("/")[2])

    def hears(self, speakers: dict[str, zenoh.Session], seconds: float, *, until: set[str]) -> set[str]:
        """Who of these was heard in some seconds; earlier, once all of `until` were."""
        self.heard.clear()
        end = time.monotonic() + seconds
        while time.monotonic() < end and not (until and until <= self.heard):
            for name, session in speakers.items():
                session.put(keys.one_of(RUN, "hello", name), b"x")
            time.sleep(0.05)
        return set(self.heard)


@pytest.mark.slow
def test_a_certificate_that_has_run_out_is_refused_on_both_ends_and_one_that_runs_out_ends_its_links(tmp_path: Path) -> None:
    make_keys(["s1", "s3"], tmp_path)
    make_keys(["s2"], tmp_path, days=0)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    ear = Ear(peer(tmp_path, "s1", listen=endpoint))
    late = Ear(peer(tmp_path, "s2", listen=f"tls/127.0.0.1:{(port := free_port())}"))
    speakers = {"s2": peer(tmp_path, "s2", dial=endpoint), "s3": peer(tmp_path, "s3", dial=endpoint)}
    to_late = {"s3": peer(tmp_path, "s3", dial=f"tls/127.0.0.1:{port}")}
    assert ear.hears(speakers, 20.0, until={"s3"}) == {"s3"}
    assert ear.hears(speakers, 1.0, until={"s2"}) == {"s3"}
    assert late.hears(to_late, 2.0, until={"s3"}) == set(), "a listener whose own certificate has run out is not dialled"

    make_keys(["s2"], tmp_path, days=6.0 / 86400.0, force=True)  # type: ignore[arg-type]
    ends = time.monotonic() + 6.0
    speakers["brief"] = peer(tmp_path, "s2", dial=endpoint)
    told = {"s2": speakers["brief"], "s3": speakers["s3"]}
    assert "s2" in ear.hears(told, 5.0, until={"s2"})
    time.sleep(max(0.0, ends + 1.0 - time.monotonic()))
    assert ear.hears(told, 1.5, until=set()) == {"s3"}
    for session in (*speakers.values(), *to_late.values(), ear._session, late._session):
        session.close()


def test_a_name_that_is_taken_from_admit_is_shut_out_by_each_process_that_starts_with_the_new_list(tmp_path: Path) -> None:
    """There is no revocation list: a process reads `admit` when it starts, and goes on with what it has read."""
    make_keys(["s1", "s2", "s3"], tmp_path)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    first = Ear(peer(tmp_path, "s1", listen=endpoint))
    speakers = {name: peer(tmp_path, name, dial=endpoint) for name in ("s2", "s3")}
    assert first.hears(speakers, 20.0, until={"s2", "s3"}) == {"s2", "s3"}
    first._session.close()
    again = Ear(peer(tmp_path, "s1", listen=endpoint, admit=("s1", "s3")))
    assert again.hears(speakers, 20.0, until={"s3"}) == {"s3"}
    assert again.hears(speakers, 1.0, until={"s2"}) == {"s3"}
    for session in (*speakers.values(), again._session):
        session.close()


def test_what_was_recorded_is_worth_nothing_to_who_replays_it(tmp_path: Path) -> None:
    """Words of s2 from the mouth of s3 are dropped; the certificate of s2 without its key opens no session."""
    make_keys(["s1", "s2", "s3"], tmp_path)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    ear = Ear(peer(tmp_path, "s1", listen=endpoint))
    thief = zenoh.open(stranger_config((endpoint,), with_keys(tmp_path), "s3"))
    assert ear.hears({"s3": thief, "s2": thief}, 20.0, until={"s3"}) == {"s3"}
    assert ear.hears({"s3": thief, "s2": thief}, 1.0, until={"s2"}) == {"s3"}
    (tmp_path / "s2.key").write_bytes((tmp_path / "s3.key").read_bytes())
    with contextlib.suppress(BadSetting):  # refused at once, or by everybody that it dials
        replayed = peer(tmp_path, "s2", dial=endpoint)
        assert ear.hears({"s2": replayed}, 2.0, until={"s2"}) == set()
        replayed.close()
    thief.close()
    ear._session.close()


@pytest.mark.slow
def test_an_endpoint_beyond_this_machine_needs_tls_or_the_word_insecure(covey: Covey) -> None:
    everywhere = f"tcp/0.0.0.0:{free_port()}"
    listen = ("--set", f"network.listen=['{everywhere}']")
    words = ("up", "quick", "--team", "A1,B1", "--lockstep", "--seconds", "5", "--spawn", "exec")
    code, _, complaints = covey.run(*words, *listen)
    assert (code, complaints.count("\n")) == (2, 1)
    assert complaints.startswith(f"covey: network.listen = '{everywhere}': leaves this machine without TLS")
    assert covey.result(*words, *listen, "--insecure")["ticks"] == 20
    code, _, complaints = covey.run(*words, "--set", "network.listen=['tls/0.0.0.0:0']")
    assert (code, complaints.count("\n")) == (2, 1)
    assert "needs certificates; `covey keys` makes them" in complaints


@pytest.mark.slow
def test_certificates_that_are_missing_or_unreadable_are_one_clear_line(covey: Covey) -> None:
    code, _, complaints = covey.run("up", "quick", "--keys", "nowhere")
    assert (code, complaints.count("\n")) == (2, 1)
    assert "nowhere/ca.pem': No such file or directory; `covey keys` makes the certificates of a swarm" in complaints
    assert covey.run("keys", "--scenario", "quick")[0] == 0
    keys, team = covey.folder / "keys", ("--set", "team.composition='A2'")
    make_keys(["s1", "s2"], keys, days=0, force=True)
    whole = {file.name: file.read_bytes() for file in keys.iterdir()}
    for file, content, complaint in (
        ("monitor.pem", b"rubbish", "keys/monitor.key': should be the key, without a password, of the certificate "),
        (
            "s1.key",
            whole["s2.key"],
            "keys/s1.key': should be the key, without a password, of the certificate ",
        ),
        ("ca.pem", b"", "keys/ca.pem': should be the certificate of an authority"),
        ("", b"", "keys/s1.pem: ran out on"),
    ):
        for name, before in {**whole, file: content or b"\n"}.items():
            if name:
                (keys / name).write_bytes(before)
        code, _, complaints = covey.run("up", "quick", "--keys", "keys", *team)
        assert (code, complaints.count("\n")) == (2, 1) and complaint in complaints, complaints
