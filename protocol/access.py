"""Access control by the common name of the certificate; every peer enforces it for itself.

An agent publishes under the keys that end in its own name, and so does its body, which has the same certificate. The world publishes
under the keys of the world, an operator the halt of all bodies. A watcher publishes nothing.
Each participant receives only what it may subscribe to. A participant without a certificate of an admitted name sends and receives nothing.

Zenoh judges a message by the neighbour at the other end of the link. Peers never relay for peers, so the neighbour is the sender.
Behind a router the neighbour would be the router.
"""

from collections.abc import Iterable
from typing import Any

from protocol.endpoints import own_endpoints
from protocol.keys import ROOT, Token, all_of, all_tokens, one_of
from protocol.settings import NetworkSettings

WORLD, WATCHER, OPERATOR = "world", "monitor", "operator"  # common names of the world, of all watchers and of all operators
FILES = (("certificate", "certificate"), ("private_key", "key"))  # Zenoh's word, field of the settings
TLS = {"verify_name_on_connect": False, "close_link_on_expiration": True}  # a certificate that runs out ends its links
TOKEN_QUERIES = ["declare_liveliness_subscriber", "liveliness_query"]
DECLARATIONS = ["declare_subscriber", "liveliness_token", "reply", *TOKEN_QUERIES]


def common_name(own: Token | None) -> str:
    """The common name of a participant: its own name, or the name that all operators or all watchers share."""
    if own is not None and own.role in ("agent", "body", "world"):
        return own.name
    return OPERATOR if own is not None and own.role == "operator" else WATCHER


def secured(settings: NetworkSettings, own: Token | None) -> dict[str, Any]:
    """The part of the Zenoh configuration that mutual TLS adds; empty without certificates.

    Only the owner of a certificate counts. Host names are not compared, so robots may change their address.
    """
    if not settings.encrypted:
        return {}
    files = settings.files(common_name(own))
    sides = {f"{side}_{what}": files[field] for side in ("listen", "connect") for what, field in FILES}
    return {
        "listen/endpoints": own_endpoints(settings),
        "transport/link/protocols": ["tls", "quic"],
        "transport/link/tls": {"root_ca_certificate": files["ca"], **sides, "enable_mtls": True, **TLS},
        "access_control": access_control(own.run if own else "*", settings.admit),
    }


def access_control(run: str, agents: Iterable[str]) -> dict[str, Any]:
    """Zenoh's `access_control` for a run with these agents; everything that is not listed is denied."""
    rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    names = [WORLD, WATCHER, OPERATOR, *agents]
    for name in names:
        own = [
            _rule(f"{name} publishes", ["put"], ["ingress"], _published(run, name)),
            _rule(f"{name} declares its tokens", ["liveliness_token", "reply"], ["ingress"], _tokens(run, name)),
            _rule(f"{name} subscribes", ["declare_subscriber"], ["ingress"], _subscribed(run, name)),
            _rule(f"{name} receives", ["put"], ["egress"], _subscribed(run, name)),
        ]
        own = [rule for rule in own if rule["key_exprs"]]
        rules += own
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [name]})
    rules.append(_rule("all ask for tokens", TOKEN_QUERIES, ["ingress"], [all_tokens(run)]))
    rules.append(_rule("own declarations go out", DECLARATIONS, ["egress"], [f"{ROOT}/{run}/**"]))
    policies.append({"rules": [rule["id"] for rule in rules[-2:]], "subjects": names})
    subjects = [{"id": name, "cert_common_names": [name]} for name in names]
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def _rule(name: str, messages: list[str], flows: list[str], expressions: list[str]) -> dict[str, Any]:
    return {"id": name, "messages": messages, "flows": flows, "permission": "allow", "key_exprs": expressions}


def _published(run: str, name: str) -> list[str]:
    """The keys under which the owner of a certificate publishes."""
    if name == WATCHER:
        return []
    if name == WORLD:
        return [one_of(run, "hello", name), all_of(run, "observation"), all_of(run, "truth")]
    if name == OPERATOR:
        return [all_of(run, "halt")]
    return [one_of(run, kind, name) for kind in ("hello", "beacon", "gossip", "observation", "pose", "command", "estimate")]


def _subscribed(run: str, name: str) -> list[str]:
    """The expressions to which the owner of a certificate may subscribe."""
    if name == WATCHER:
        return [f"{ROOT}/{run}/**"]
    if name == WORLD:
        return [all_of(run, "hello"), all_of(run, "command"), all_of(run, "halt")]
    if name == OPERATOR:
        return [all_of(run, "observation")]
    everybodys, own = ("hello", "beacon", "gossip", "pose", "halt"), ("observation", "command", "estimate")
    return [*(all_of(run, kind) for kind in everybodys), *(one_of(run, kind, name) for kind in own)]


def _tokens(run: str, name: str) -> list[str]:
    """The liveliness tokens of the owner of a certificate."""
    if name == WATCHER:
        return [f"{ROOT}/{run}/alive/monitor/**", f"{ROOT}/{run}/alive/recorder/**"]
    if name == OPERATOR:
        return [f"{ROOT}/{run}/alive/operator/**"]
    roles = [WORLD] if name == WORLD else ["agent", "body"]
    return [f"{ROOT}/{run}/alive/{role}/{name}/*" for role in roles]
