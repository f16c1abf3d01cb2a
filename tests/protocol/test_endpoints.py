"""Endpoints beyond this machine are refused unless they are encrypted or the settings say insecure."""

import socket
import ssl
import subprocess
import sys
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization

from deploy.live.certificates import make_keys
from protocol.endpoints import check_endpoints, check_files, check_owner, common_names, free_port, own_endpoints
from protocol.keys import Token
from protocol.live import open_session
from protocol.settings import BadSetting, NetworkSettings
from protocol.zenoh_settings import session_values

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:0", "tcp/localhost:7447", "tcp/[::1]:7447", "tls/10.0.0.1:7447", "quic/example.org:1"])
def test_loopback_and_encrypted_endpoints_are_accepted(endpoint: str) -> None:
    files = {"ca": "ca.pem", "certificate": "{name}.pem", "key": "{name}.key"} if endpoint.startswith(("tls", "quic")) else {}
    check_endpoints(NetworkSettings(listen=(endpoint,), seeds=(endpoint,), **files))


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "udp/192.168.1.2:7447", "tcp/127.0.0.1.example.org:1"])
def test_an_open_endpoint_is_refused_with_field_and_value_unless_insecure(endpoint: str) -> None:
    with pytest.raises(BadSetting, match=r"network\.seeds = .*TLS"):
        check_endpoints(NetworkSettings(seeds=(endpoint,)))
    check_endpoints(NetworkSettings(seeds=(endpoint,), insecure=True))


@pytest.mark.parametrize("endpoint", ["127.0.0.1:1", "tcp/127.0.0.1", "tls/10.0.0.1:x", "tcp/127.0.0.1:65536", "tcp//127.0.0.1:1"])
def test_an_endpoint_that_cannot_be_read_is_refused_even_when_insecure(endpoint: str) -> None:
    """Zenoh dials one without a port for ever, and says nothing."""
    with pytest.raises(BadSetting, match=rf"network\.listen = '{endpoint}': should read .* at most 65535"):
        check_endpoints(NetworkSettings(listen=(endpoint,), insecure=True))
    check_endpoints(NetworkSettings(listen=("tcp/[::1]:65535?rel=1#iface=lo", "unixsock-stream/tmp/x", "tcp/localhost:0")))


FILES = {"ca": "ca.pem", "certificate": "{name}.pem", "key": "{name}.key"}


@pytest.mark.parametrize("endpoint", ["tls/10.0.0.1:7447", "quic/10.0.0.1:7447"])
def test_an_encrypted_endpoint_needs_certificates(endpoint: str) -> None:
    with pytest.raises(BadSetting, match=r"network\.seeds = .*needs certificates"):
        check_endpoints(NetworkSettings(seeds=(endpoint,)))


def test_with_certificates_there_is_no_plain_side_door_and_no_router() -> None:
    check_endpoints(NetworkSettings(**FILES))
    assert own_endpoints(NetworkSettings(**FILES)) == ("tls/127.0.0.1:0",)
    assert own_endpoints(NetworkSettings()) == ("tcp/127.0.0.1:0",)
    for field, endpoint in (("listen", "tcp/127.0.0.1:7447"), ("seeds", "tcp/127.0.0.1:7447")):
        with pytest.raises(BadSetting, match=rf"network\.{field} = .*should be tls"):
            check_endpoints(NetworkSettings(**FILES, **{field: (endpoint,)}))
    with pytest.raises(BadSetting, match=r"network\.mode = client: .*should be peer"):
        check_endpoints(NetworkSettings(mode="client", **FILES))


def test_files_are_missed_by_name_and_field(tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_text("")
    (tmp_path / "s1.pem").write_text("")
    settings = NetworkSettings(ca=str(tmp_path / "ca.pem"), certificate=str(tmp_path / "{name}.pem"))
    with pytest.raises(BadSetting, match=r"network\.key = '': is not given"):
        check_files(settings, "s1")
    with pytest.raises(BadSetting, match=r"network\.certificate = .*s2\.pem': No such file"):
        check_files(settings, "s2")
    check_files(NetworkSettings(), "s1")


def test_files_that_are_not_what_they_should_be_are_named_and_none_asks_for_a_password(tmp_path: Path) -> None:
    make_keys(["s1", "s2"], tmp_path)
    settings = NetworkSettings(**{field: str(tmp_path / file) for field, file in (*FILES.items(), ("ca", "ca.pem"))})
    check_files(settings, "s1")
    own = serialization.load_pem_private_key((tmp_path / "s1.key").read_bytes(), None)
    locked = own.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.BestAvailableEncryption(b"secret")
    )
    for content in ((tmp_path / "s2.key").read_bytes(), b"rubbish", locked):
        (tmp_path / "s1.key").write_bytes(content)
        with pytest.raises(
            BadSetting, match=r"network\.key = '.*s1\.key': should be the key, without a password, of the certificate .*s1\.pem$"
        ):
            check_files(settings, "s1")
    (tmp_path / "ca.pem").write_text("")
    with pytest.raises(BadSetting, match=r"network\.ca = '.*ca\.pem': should be the certificate of an authority"):
        check_files(settings, "s2")


def test_the_certificate_of_another_name_is_refused_where_its_holder_would_only_be_silent(tmp_path: Path) -> None:
    """All links come about, and each receiver drops what the holder says under its own name."""
    make_keys(["s1", "s2"], tmp_path)
    settings = NetworkSettings(
        **{field: str(tmp_path / file) for field, file in (("ca", "ca.pem"), ("certificate", "s1.pem"), ("key", "s1.key"))}
    )
    assert common_names((tmp_path / "s1.pem").read_text() + (tmp_path / "s2.pem").read_text()) == {"covey authority", "s1"}
    check_owner(settings, "s1")
    check_owner(NetworkSettings(), "s2")
    with pytest.raises(BadSetting, match=r"network\.certificate = .*s1\.pem': is not the certificate of s2, but names covey authority, s1"):
        check_owner(settings, "s2")
    with pytest.raises(BadSetting, match="is not the certificate of s2"):
        open_session(settings, Token("r", "agent", "s2", 1))


def test_a_name_in_another_encoding_is_read_as_far_as_it_goes() -> None:
    latin = b"\x06\x03\x55\x04\x03\x14\x04caf\xe9"
    assert common_names(ssl.DER_cert_to_PEM_cert(latin)) == {"caf\ufffd"}


def test_a_free_port_lies_below_the_range_of_outgoing_connections() -> None:
    assert 20000 <= free_port() < 32000


def test_a_free_port_is_free_for_a_udp_or_quic_endpoint() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", free_port()))


def test_a_port_on_which_somebody_listens_is_not_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("protocol.endpoints.os.urandom", bytes)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", following := free_port() + 7))
        assert free_port() != following


def test_a_port_that_was_given_away_is_given_to_nobody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody listens on it yet: the swarm that asked is still starting, and another one starts beside it."""
    program = "import os; os.urandom = bytes; from protocol.endpoints import free_port; print(free_port(), flush=True); input()"
    first = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert first.stdin and first.stdout
    taken = int(first.stdout.readline())
    monkeypatch.setattr("protocol.endpoints.os.urandom", bytes)
    mine = [free_port(), free_port()]
    assert len({taken, *mine}) == 3
    first.communicate("done")
    assert first.returncode == 0


@pytest.mark.parametrize(
    ("listen", "seeds", "seconds"),
    [
        (("udp/127.0.0.1:0",), (), 15),
        (("udp/127.0.0.1:0",), ("udp/127.0.0.1:7447",), 15),
        (("udp/127.0.0.1:0",), ("tcp/127.0.0.1:7447",), 60),
        (("tcp/127.0.0.1:0", "udp/127.0.0.1:0"), (), 60),
    ],
)
def test_a_lost_packet_of_a_handshake_costs_less_time_where_all_links_are_udp(
    listen: tuple[str, ...], seeds: tuple[str, ...], seconds: int
) -> None:
    values = session_values(NetworkSettings(listen=listen, seeds=seeds))
    assert values["transport/unicast/open_timeout"] == 1000 * seconds
