"""A small client of a run: a session, a token, what is said and what is heard. Python with zenoh and msgpack, and nothing else.

It is the part that a participant in another language needs first (docs/reference/protocol.md, *Transport*, *Keys*, *Encoding*). With
certificates it keeps the access control of a body itself, as every peer does: who says what is judged by the certificate.
"""

import contextlib
import json
import queue
import threading
import time
from functools import partial
from typing import Any, NamedTuple

import msgpack
import zenoh

WIRE = 2
MAX_BYTES = 524288
RETRY_SECONDS = 0.5  # between two attempts to join again
TLS = {"verify_name_on_connect": False, "close_link_on_expiration": True}
DROP = zenoh.CongestionControl.DROP
Fields = dict[str, Any]


class Heard(NamedTuple):
    """A message with its fields, or a token that came or went, without."""

    kind: str
    name: str
    fields: Fields
    incarnation: int = 0
    up: bool = True


class Network(NamedTuple):
    """How a run is reached; the files are those of mutual TLS, empty without."""

    seeds: tuple[str, ...]
    listen: tuple[str, ...] = ("tcp/127.0.0.1:0",)
    ca: str = ""
    certificate: str = ""
    key: str = ""
    admitted: tuple[str, ...] = ()
    mode: str = "peer"  # or "client", of the routers among the seeds
    lease: float = 5.0  # s without a byte until a link counts as lost


class Participant:
    """A participant of a run, with the role of a body."""

    def __init__(self, network: Network, run: str, name: str) -> None:
        self.incarnation = time.time_ns() // 1_000_000
        self.events: queue.SimpleQueue[Heard] = queue.SimpleQueue()
        self._network, self._run, self._name = network, run, name
        self._keys: list[str] = []  # that are listened to
        self._up: set[tuple[str, str, int]] = set()  # role, name and incarnation of the tokens that this session has seen
        self._telling = threading.Lock()  # held while tokens of a session are told, for threads of the one before may still run
        self._publishers: dict[str, tuple[Any, zenoh.SourceInfo]] = {}
        self._token: Any = None
        self._held: list[Any] = []
        self._session: zenoh.Session | None = None  # None: on the way to another one
        self._join()

    def _join(self) -> None:
        """Open a session with all subscriptions; the tokens of an earlier one, or of a failed attempt, are gone."""
        with self._telling:
            gone, self._up = self._up, set()
            for role, name, incarnation in gone:
                self.events.put(Heard(role, name, {}, incarnation, up=False))
        session = zenoh.open(config_of(self._network, self._run, self._name))
        on_token = partial(self._on_token, self._up)
        self._held = [session.liveliness().declare_subscriber(f"covey/{self._run}/alive/**", on_token, history=True)]
        self._held += [self._subscriber(session, key) for key in self._keys]
        self._session = session

    def _subscriber(self, session: zenoh.Session, key: str) -> Any:
        return session.declare_subscriber(f"covey/{self._run}/{key}", self._on_sample, allowed_origin=zenoh.Locality.REMOTE)

    def listen(self, *keys: str) -> None:
        """Subscribe to keys within the run, such as gossip/*."""
        self._keys += keys
        if self._session is not None:
            self._held += [self._subscriber(self._session, key) for key in keys]

    def rejoin(self) -> None:
        """Leave the network and join it again, in a thread: a client waits for its router. What is said meanwhile is lost."""
        session, self._session = self._session, None
        if session is not None:
            declared = [self._publishers, self._token, self._held]  # released when the session is closed
            self._publishers, self._token = {}, None
            threading.Thread(target=self._leave_and_join, args=(session, declared), daemon=True).start()

    def _leave_and_join(self, session: zenoh.Session, declared: list[Any]) -> None:
        with contextlib.suppress(zenoh.ZError):
            session.close()
        declared.clear()
        while self._session is None:
            try:
                self._join()
            except zenoh.ZError:  # the old session may still hold the port
                time.sleep(RETRY_SECONDS)

    def appear(self, up: bool) -> None:
        """Declare the token, or take it back; of no effect where that is so already."""
        if up and self._token is None and self._session is not None:
            expression = f"covey/{self._run}/alive/body/{self._name}/{self.incarnation}"
            self._token = self._session.liveliness().declare_token(expression)
        elif not up and self._token is not None:
            self._token.undeclare()
            self._token = None

    def say(self, kind: str, fields: Fields) -> None:
        """Publish a message of this kind under the own name."""
        if self._session is None:
            return
        said = {"type": kind, "sender": self._name, "incarnation": self.incarnation, "wire": WIRE, **fields}
        key = f"covey/{self._run}/{kind}/{self._name}"
        if key not in self._publishers:
            publisher = self._session.declare_publisher(key, congestion_control=DROP)
            self._publishers[key] = publisher, zenoh.SourceInfo(publisher.id, 0)
        publisher, source = self._publishers[key]
        publisher.put(msgpack.packb(said), source_info=source)

    def close(self) -> None:
        """Leave the run."""
        if self._session is not None:
            self._session.close()

    def _on_token(self, seen: set[tuple[str, str, int]], sample: zenoh.Sample) -> None:
        """Tell of a token that came or went; `seen`: those of the session that says so, which counts if it is the present one."""
        parts, up = str(sample.key_expr).split("/"), sample.kind == zenoh.SampleKind.PUT
        if len(parts) != 6 or not (parts[5].isascii() and parts[5].isdecimal()):
            return  # a token of another form is passed over
        *_, role, name, number = parts
        with self._telling:
            if seen is self._up:
                (seen.add if up else seen.discard)((role, name, int(number)))
                self.events.put(Heard(role, name, {}, int(number), up))

    def _on_sample(self, sample: zenoh.Sample) -> None:
        """Hand on a message that is whole and of this version; whatever else comes is passed over."""
        payload, parts = sample.payload.to_bytes(), str(sample.key_expr).split("/")
        try:
            fields: Fields = msgpack.unpackb(payload) if len(payload) <= MAX_BYTES else {}
            is_read = fields.get("wire", WIRE) == WIRE and type(fields["incarnation"]) is int
            if is_read and (len(parts) == 3 or fields["sender"] == parts[3]):
                self.events.put(Heard(parts[2], fields["sender"], fields, fields["incarnation"]))
        except (ValueError, TypeError, KeyError, AttributeError, msgpack.UnpackException):
            return


def config_of(network: Network, run: str, name: str) -> zenoh.Config:
    """The session, as the table under *Transport* says."""
    values: Fields = {
        "mode": network.mode,
        "listen/endpoints": network.listen if network.mode == "peer" else (),
        "connect/endpoints": network.seeds,
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "scouting/gossip/autoconnect_strategy": {"peer": {"to_peer": "greater-zid", "to_router": "always"}},
        "transport/link/tx/lease": round(1000.0 * network.lease),
        "transport/link/tx/keep_alive": 4,
        "transport/link/tx/queue/size/data": 16,
        "transport/link/rx/max_message_size": MAX_BYTES,
        "transport/shared_memory/enabled": False,
    }
    if network.ca:
        sides = {f"{side}_certificate": network.certificate for side in ("listen", "connect")}
        sides |= {f"{side}_private_key": network.key for side in ("listen", "connect")}
        tls = {"root_ca_certificate": network.ca, **sides, "enable_mtls": True, **TLS}
        values |= {"transport/link/protocols": ["tls", "quic"], "transport/link/tls": tls}
        values["access_control"] = access_control(run, name, network.admitted)
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config


def access_control(run: str, name: str, agents: tuple[str, ...]) -> Fields:
    """What a body lets in and out, by the common name of the certificate at the other end of the link; all else is denied."""
    root = f"covey/{run}"
    mine = [f"{root}/{kind}/{name}" for kind in ("observation", "command", "estimate")]
    pose = f"{root}/pose/{name}"
    rules, policies = list[Fields](), list[Fields]()

    def allow(who: str, flow: str, messages: list[str], keys: list[str]) -> None:
        label = f"{who} {flow} {messages[0]}"
        rules.append({"id": label, "messages": messages, "flows": [flow], "permission": "allow", "key_exprs": keys})
        policies.append({"rules": [label], "subjects": [who] if who != "all" else everybody})

    everybody = ["monitor", "operator", *agents]
    for agent in agents:
        says = [*(f"{root}/{kind}/{agent}" for kind in ("gossip", "hello", "pose")), *(mine[1:] if agent == name else [])]
        allow(agent, "ingress", ["put"], says)
        allow(agent, "ingress", ["declare_subscriber"], [pose, *(mine[:1] if agent == name else [])])
        allow(agent, "egress", ["put"], [pose, *(mine[:1] if agent == name else [])])
        allow(agent, "ingress", ["liveliness_token", "reply"], [f"{root}/alive/{role}/{agent}/*" for role in ("agent", "body")])
    allow("operator", "ingress", ["put"], [f"{root}/halt"])
    for who, keys in (("monitor", [f"{root}/**"]), ("operator", mine[:1])):
        allow(who, "ingress", ["declare_subscriber"], keys)
        allow(who, "egress", ["put"], [*mine[:1], pose] if who == "monitor" else keys)
    allow("all", "ingress", ["declare_liveliness_subscriber", "liveliness_query"], [f"{root}/alive/**"])
    out = ["declare_subscriber", "liveliness_token", "reply", "declare_liveliness_subscriber", "liveliness_query"]
    allow("all", "egress", out, [f"{root}/**"])
    subjects = [{"id": who, "cert_common_names": [who]} for who in everybody]
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}
