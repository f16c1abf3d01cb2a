"""Why nobody is found: the network of a scenario is tried from this machine, one cause after the other.

The seeds are dialled as plain sockets first, and with certificates as TLS. Then a Zenoh session listens for a moment, with the
certificate of one process, and without a token: nobody takes it for that process. It hears who is there and what their Hellos say.
"""

import contextlib
import re
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, wait
from typing import Any, NamedTuple

import msgpack
import msgspec

from deploy.live.certificates import wrong_with_certificate
from deploy.scenario import Scenario, agent_config
from protocol import codec, live
from protocol.access import WATCHER, common_name
from protocol.endpoints import check_endpoints, check_files
from protocol.fields import Malformed
from protocol.keys import ROOT, Token, order, parse_token
from protocol.message import WIRE_VERSION, SharedSettings
from protocol.messages import Hello
from protocol.settings import BadSetting, NetworkSettings
from protocol.settings_digest import differing_settings

REACH_SECONDS = 3.0  # for a connection to one seed
ALERT_SECONDS = 0.5  # in which a peer that refuses a certificate says so
CLOSE_SECONDS = 1.0
LISTEN_SECONDS = 5.0  # Hellos come every 2 s, and every 4 s in a large swarm


class Finding(NamedTuple):
    """One line of the result: whether it is as it should be."""

    right: bool
    text: str


class Overheard:
    """What a session hears of all runs: tokens, and the newest Hello of each name."""

    def __init__(self) -> None:
        self.tokens: set[Token] = set()
        self.hellos: dict[tuple[str, str], dict[str, Any]] = {}  # run, sender -> fields as they came

    def token(self, sample: Any) -> None:
        """Note a liveliness token."""
        if token := parse_token(str(sample.key_expr)):
            self.tokens.add(token)

    def hello(self, sample: Any) -> None:
        """Note a Hello, also one of another wire version."""
        with contextlib.suppress(ValueError, msgpack.UnpackException):
            fields = msgpack.unpackb(sample.payload.to_bytes())
            if isinstance(fields, dict):
                _, run, _, name = str(sample.key_expr).split("/")
                self.hellos[run, name] = fields


def check_network(scenario: Scenario, name: str, seconds: float = LISTEN_SECONDS) -> Iterator[Finding]:
    """What is found on the network of a scenario, with the certificate of `name`; raises BadSetting where it cannot be tried."""
    network = msgspec.structs.replace(scenario.network, admit=scenario.network.admit or tuple(scenario.members))
    if name != WATCHER and network.admit and name not in network.admit:
        raise BadSetting(f"--as {name}: should be {WATCHER}, or one of {', '.join(network.admit)}")
    own = Token(scenario.run.name, WATCHER if name == WATCHER else "agent", name, 0)
    check_endpoints(network)
    check_files(network, common_name(own))
    if not network.seeds:
        raise BadSetting("network.seeds is empty: nobody is dialled; should hold endpoints of the swarm, such as 'tls/10.0.0.1:7447'")
    if network.encrypted:
        yield from (Finding(False, text) for text in wrong_with_certificate(network, common_name(own)))
    reached = False
    for seed in network.seeds:
        finding = _seed(seed, network, common_name(own))
        reached = reached or finding.right
        yield finding
    if reached:
        heard, links = _listen(network, own, seconds)
        yield from _who_is_there(scenario, heard, links, network.encrypted, name)


def _seed(seed: str, network: NetworkSettings, name: str) -> Finding:
    """Whether somebody listens at an endpoint, and with certificates whether both sides accept each other."""
    found = re.fullmatch(r"(tcp|tls)/\[?([^\]]+?)\]?:(\d+)", seed)
    if not found:
        return Finding(True, f"{seed}: not tried by itself, only tcp/ and tls/ are")
    try:
        with socket.create_connection((found[2], int(found[3])), timeout=REACH_SECONDS) as connection:
            return _handshake(seed, connection, network, name) if found[1] == "tls" else Finding(True, f"{seed}: somebody listens")
    except (OSError, UnicodeError) as error:  # the second for what can be no host name
        reason = getattr(error, "strerror", None) or str(error)
        return Finding(False, f"{seed}: cannot be reached: {reason}; is the process up, the address right, the port open in the firewall?")


def _handshake(seed: str, connection: socket.socket, network: NetworkSettings, name: str) -> Finding:
    """Mutual TLS with whoever listens."""
    files = network.files(name)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)  # as strict as Zenoh: the default one of Python 3.13 asks for more
    context.check_hostname = False
    context.load_verify_locations(files["ca"])
    context.load_cert_chain(files["certificate"], files["key"])
    try:
        with context.wrap_socket(connection) as secured:
            secured.settimeout(ALERT_SECONDS)
            with contextlib.suppress(TimeoutError):
                secured.recv(1)  # with TLS 1.3 a refusal of the own certificate comes after the handshake
            subject = dict(pair[0] for pair in secured.getpeercert()["subject"])  # type: ignore[index, misc]
            return Finding(True, f"{seed}: {subject['commonName']} listens, and both certificates are accepted")
    except ssl.SSLCertVerificationError as error:
        return Finding(False, f"{seed}: its certificate is not accepted here: {error.verify_message}; is network.ca its authority?")
    except (ssl.SSLError, ConnectionResetError) as error:
        reason = getattr(error, "reason", None) or "the connection was reset"
        return Finding(False, f"{seed}: the certificate of {name} is not accepted there, or no TLS is spoken: {reason}")


def _listen(network: NetworkSettings, own: Token, seconds: float) -> tuple[Overheard, int]:
    """What a session hears for some seconds, and its links at the end."""
    heard, session = Overheard(), _opened(network, own)
    if session is None:
        return heard, 0
    runs = [own.run] if network.encrypted else ["*"]  # access control lets a certificate ask for its own run alone
    held = [session.declare_subscriber(f"{ROOT}/{run}/hello/*", heard.hello) for run in runs]
    held += [session.liveliness().declare_subscriber(f"{ROOT}/{run}/alive/**", heard.token, history=True) for run in runs]
    try:
        time.sleep(seconds)
        return heard, len([*session.info.peers_zid(), *session.info.routers_zid()])
    finally:
        held.clear()
        closing = threading.Thread(target=_close, args=(session,), daemon=True)  # it takes long where a link was never answered
        closing.start()
        closing.join(CLOSE_SECONDS)


def _opened(network: NetworkSettings, own: Token) -> Any:
    """A Zenoh session; None if a client has found no router in `REACH_SECONDS`."""
    result = Future[Any]()
    threading.Thread(target=live.open_for, args=(result, network, own), daemon=True).start()
    wait([result], timeout=REACH_SECONDS)
    return None if result.cancel() else result.result()


def _close(session: Any) -> None:
    with contextlib.suppress(Exception):  # Zenoh's time-out
        session.close()


def _who_is_there(scenario: Scenario, heard: Overheard, links: int, encrypted: bool, name: str) -> Iterator[Finding]:
    """Who was heard in this run, or why nobody was."""
    run = scenario.run.name
    here = sorted({(token.role, token.name) for token in heard.tokens if token.run == run}, key=lambda each: (each[0], order(each[1])))
    others = sorted({token.run for token in heard.tokens if token.run != run})
    if here:
        yield Finding(True, f"run {run}: found " + ", ".join(f"{role} {who}" for role, who in here))
    elif others:
        yield Finding(False, f"run.name = {run!r}: nobody is in this run; there is {', '.join(map(repr, others))}")
    elif links and encrypted:
        yield Finding(False, f"{links} linked, and nobody says anything in run {run!r}: they have another run.name, or do not admit {name}")
    elif links:
        yield Finding(False, f"{links} linked, and nobody is in any run: is that a Zenoh router, or a process of another kind?")
    else:
        yield Finding(False, "no Zenoh session was linked: whoever listens there speaks no Zenoh, or another version of it")
    mine = agent_config(scenario).shared_settings()
    for (where, sender), fields in sorted(heard.hellos.items(), key=lambda item: (item[0][0], order(item[0][1]))):
        if where == run:
            yield from _compatible(sender, fields, mine)


def _compatible(sender: str, fields: dict[str, Any], mine: SharedSettings) -> Iterator[Finding]:
    """Whether a Hello is of this wire version, and what its settings say otherwise."""
    if fields.get("wire") != WIRE_VERSION:
        software = f" ({fields['software']})" if fields.get("software") else ""
        yield Finding(
            False, f"{sender}: speaks wire version {fields.get('wire')}{software}, this is {WIRE_VERSION}: install the same release"
        )
        return
    try:
        hello = codec.decode(f"{ROOT}/x/hello/{sender}", msgpack.packb(fields))
    except Malformed as error:
        yield Finding(False, f"{sender}: its Hello is refused: {error}")
        return
    assert isinstance(hello, Hello)
    for dotted in differing_settings(mine, hello.settings):
        section, _, field = dotted.rpartition(".")
        theirs, ours = hello.settings[section][field], mine[section][field]
        yield Finding(False, f"{sender}: {dotted} is {theirs!r} there and {ours!r} here; should be the same everywhere")
