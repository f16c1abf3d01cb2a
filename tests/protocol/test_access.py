"""What a name may say and hear, worked out from the access control as Zenoh applies it: what is not allowed is denied."""

import pytest

from protocol.access import access_control, common_name, secured
from protocol.keys import RUN_WIDE_KINDS, Token, all_of, matches, one_of, token_key
from protocol.settings import NetworkSettings

RULES = access_control("r", ("s1", "s2"))
KINDS = ("hello", "beacon", "gossip", "observation", "pose", "command", "estimate")


def allowed(name: str, message: str, flow: str, key: str) -> bool:
    """Whether a message under a key passes between this peer and the owner of a certificate."""
    rules = {rule["id"]: rule for rule in RULES["rules"]}
    mine = [rules[number] for policy in RULES["policies"] if name in policy["subjects"] for number in policy["rules"]]
    return any(message in rule["messages"] and flow in rule["flows"] and any(matches(e, key) for e in rule["key_exprs"]) for rule in mine)


def written_by(name: str) -> set[str]:
    keys = {one_of("r", kind, owner) for kind in KINDS for owner in ("s1", "s2", "world")} | {all_of("r", kind) for kind in RUN_WIDE_KINDS}
    return {key.removeprefix("covey/r/").replace("*/*/", "") for key in keys if allowed(name, "put", "ingress", key)}


def heard_by(name: str) -> set[str]:
    keys = {one_of("r", kind, "s1") for kind in KINDS} | {one_of("r", "observation", "s2"), *(all_of("r", kind) for kind in RUN_WIDE_KINDS)}
    heard = {key for key in keys if allowed(name, "put", "egress", key)}
    assert heard == {key for key in keys if allowed(name, "declare_subscriber", "ingress", key)}
    return {key.removeprefix("covey/r/").replace("*/*/", "") for key in heard}


def test_a_name_writes_its_own_keys_only() -> None:
    assert written_by("s1") == {"hello/s1", "beacon/s1", "gossip/s1", "observation/s1", "pose/s1", "command/s1", "estimate/s1"}
    assert written_by("world") == {"hello/world", "observation/s1", "observation/s2", "observation/world", "truth"}
    assert written_by("monitor") == set()
    assert written_by("operator") == {"halt"}
    assert written_by("x9") == set()


def test_an_agent_is_never_sent_the_truth_or_anothers_estimate_or_observation() -> None:
    assert heard_by("s1") == {"hello/s1", "beacon/s1", "gossip/s1", "observation/s1", "pose/s1", "command/s1", "estimate/s1", "halt"}
    assert heard_by("s2") == {"hello/s1", "beacon/s1", "gossip/s1", "observation/s2", "pose/s1", "halt"}
    assert heard_by("world") == {"hello/s1", "command/s1", "halt"}
    assert heard_by("operator") == {"observation/s1", "observation/s2"}
    assert len(heard_by("monitor")) == 10
    assert heard_by("x9") == set()


def test_a_name_holds_its_own_tokens_only_and_everybody_of_the_run_may_look() -> None:
    for name, role, owner in [
        ("s1", "agent", "s1"),
        ("world", "world", "world"),
        ("monitor", "monitor", "ls-7"),
        ("monitor", "recorder", "x"),
        ("s1", "body", "s1"),
        ("operator", "operator", "operator-7"),
    ]:
        assert allowed(name, "liveliness_token", "ingress", token_key("r", role, owner, 5))
    for name, role, owner in [
        ("s1", "agent", "s2"),
        ("s1", "body", "s2"),
        ("s1", "operator", "s1"),
        ("s1", "world", "world"),
        ("monitor", "agent", "s1"),
        ("world", "agent", "s1"),
    ]:
        assert not allowed(name, "liveliness_token", "ingress", token_key("r", role, owner, 5))
    assert allowed("s2", "declare_liveliness_subscriber", "ingress", "covey/r/alive/agent/s1/1")
    assert not allowed("s2", "declare_liveliness_subscriber", "ingress", "covey/other/alive/agent/s1/1")


def test_what_is_not_listed_is_denied() -> None:
    assert RULES["enabled"] is True and RULES["default_permission"] == "deny"
    assert {rule["permission"] for rule in RULES["rules"]} == {"allow"}
    for message in ("delete", "query", "declare_queryable"):
        assert not any(message in rule["messages"] for rule in RULES["rules"])


@pytest.mark.parametrize(
    ("role", "name", "expected"),
    [
        ("agent", "s1", "s1"),
        ("body", "s1", "s1"),
        ("world", "world", "world"),
        ("operator", "operator-7", "operator"),
        ("recorder", "rec-7", "monitor"),
    ],
)
def test_watchers_share_one_certificate(role: str, name: str, expected: str) -> None:
    assert common_name(Token("r", role, name, 1)) == expected
    settings = NetworkSettings(ca="ca.pem", certificate="{name}.pem", key="{name}.key", admit=("s1",))
    tls = secured(settings, Token("r", role, name, 1))["transport/link/tls"]
    assert tls["listen_certificate"] == tls["connect_certificate"] == f"{expected}.pem"
    assert tls["enable_mtls"] is True
    assert secured(NetworkSettings(), Token("r", role, name, 1)) == {}
