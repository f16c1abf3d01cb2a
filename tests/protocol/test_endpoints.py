"""Endpoints beyond this machine are refused unless they are encrypted or the settings say insecure."""

import pytest

from protocol.endpoints import check_endpoints, free_port
from protocol.settings import BadSetting, NetworkSettings


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:0", "tcp/localhost:7447", "tcp/[::1]:7447", "tls/10.0.0.1:7447", "quic/example.org:1"])
def test_loopback_and_encrypted_endpoints_are_accepted(endpoint: str) -> None:
    files = {"ca": "ca.pem", "certificate": "{name}.pem", "key": "{name}.key"} if endpoint.startswith(("tls", "quic")) else {}
    check_endpoints(NetworkSettings(listen=(endpoint,), seeds=(endpoint,), **files))


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "udp/192.168.1.2:7447", "tcp/127.0.0.1.example.org:1"])
def test_an_open_endpoint_is_refused_with_field_and_value_unless_insecure(endpoint: str) -> None:
    with pytest.raises(BadSetting, match=r"network\.seeds = .*TLS"):
        check_endpoints(NetworkSettings(seeds=(endpoint,)))
    check_endpoints(NetworkSettings(seeds=(endpoint,), insecure=True))


def test_an_endpoint_that_cannot_be_read_is_refused_even_when_insecure() -> None:
    with pytest.raises(BadSetting, match=r"network\.listen = '127\.0\.0\.1:1': should read"):
        check_endpoints(NetworkSettings(listen=("127.0.0.1:1",), insecure=True))


def test_a_free_port_lies_below_the_range_of_outgoing_connections() -> None:
    assert 20000 <= free_port() < 32000
