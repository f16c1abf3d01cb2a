"""`covey check --network`: every reason why nobody is found is provoked, with real sockets, certificates and sessions."""

import contextlib
import json
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cryptography import x509

from deploy.live.certificates import make_keys
from deploy.live.network_check import check_network
from deploy.scenario import Scenario, agent_config, resolve
from protocol import codec, keys, live
from protocol.endpoints import free_port
from protocol.messages import Hello
from protocol.settings import BadSetting, NetworkSettings

pytestmark = pytest.mark.live
NAMES = ("s1", "s2")
ROOT = Path(__file__).resolve().parents[2]


def scenario_at(seed: str, folder: Path | None = None, **settings: Any) -> Scenario:
    """A scenario whose swarm is dialled there, with the certificates of a folder."""
    files = {"ca": f"{folder}/ca.pem", "certificate": f"{folder}/{{name}}.pem", "key": f"{folder}/{{name}}.key"} if folder else {}
    options = {"team.composition": "A2", "run.name": "lab", "network.seeds": [seed], **settings}
    return resolve("quick", {**options, **{f"network.{field}": value for field, value in files.items()}})


@contextlib.contextmanager
def greeting(scenario: Scenario, endpoint: str, seeds: tuple[str, ...] = (), **changed: Any) -> Iterator[None]:
    """A peer s1 that listens there, dials the seeds, is alive, and says Hello ten times a second, with changed fields."""
    admitted = scenario.network.admit or NAMES
    network = msgspec.structs.replace(scenario.network, mode="peer", listen=(endpoint,), seeds=seeds, admit=admitted)
    session = live.open_session(network, keys.Token(scenario.run.name, "agent", "s1", 7))
    token = session.liveliness().declare_token(keys.token_key(scenario.run.name, "agent", "s1", 7))
    hello = Hello(sender="s1", incarnation=7, settings=agent_config(scenario).shared_settings())
    payload = msgspec.msgpack.encode({**msgspec.msgpack.decode(codec.encode(hello)), **changed})
    over = threading.Event()

    def speak() -> None:
        while not over.wait(0.1):
            session.put(keys.message_key(scenario.run.name, hello), payload)

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        token.undeclare()
        session.close()


def wrong(scenario: Scenario, name: str = "monitor") -> list[str]:
    """What the check finds wrong."""
    return [text for right, text in check_network(scenario, name, seconds=0.6) if not right]


@pytest.mark.slow
def test_a_swarm_that_is_as_it_should_be_is_found_with_and_without_certificates(tmp_path: Path) -> None:
    make_keys([*NAMES, "monitor"], tmp_path / "keys")
    for protocol, folder in (("tcp", None), ("tls", tmp_path / "keys")):
        scenario = scenario_at(f"{protocol}/127.0.0.1:{free_port()}", folder)
        with greeting(scenario, scenario.network.seeds[0]):
            for name in ("monitor", "s2"):
                found = [*check_network(scenario, name, seconds=0.6)]
                assert all(right for right, _ in found), found
                assert found[-1].text == "run lab: found agent s1"


def test_a_seed_where_nobody_listens_is_named() -> None:
    seed = f"tcp/127.0.0.1:{free_port()}"
    [line] = wrong(scenario_at(seed))
    assert line == f"{seed}: cannot be reached: Connection refused; is the process up, the address right, the port open in the firewall?"
    [line] = wrong(scenario_at("tcp/nowhere.invalid:7447", **{"network.insecure": True}))
    [unnamed] = wrong(scenario_at("tcp/..:7447", **{"network.insecure": True}))
    assert unnamed.startswith("tcp/..:7447: cannot be reached: ")
    assert line.startswith("tcp/nowhere.invalid:7447: cannot be reached: Name or service not known") or "name resolution" in line


@pytest.mark.parametrize("mode", ["peer", pytest.param("client", marks=pytest.mark.slow)])
def test_somebody_who_speaks_no_zenoh_is_told_apart_from_nobody(mode: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        [line] = wrong(scenario_at(f"tcp/127.0.0.1:{deaf.getsockname()[1]}", **{"network.mode": mode}))
    assert line == "no Zenoh session was linked: whoever listens there speaks no Zenoh, or another version of it"


def test_certificates_that_one_side_does_not_accept_are_told_by_side(tmp_path: Path) -> None:
    for folder in ("ours", "theirs"):
        make_keys([*NAMES, "monitor"], tmp_path / folder)
    scenario = scenario_at(f"tls/127.0.0.1:{free_port()}", tmp_path / "ours")
    with greeting(scenario, scenario.network.seeds[0]):
        foreign = scenario_at(scenario.network.seeds[0], tmp_path / "theirs")
        assert "its certificate is not accepted here" in wrong(foreign)[0]
        mixed = msgspec.structs.replace(foreign.network, ca=str(tmp_path / "ours" / "ca.pem"))
        lines = wrong(msgspec.structs.replace(foreign, network=mixed))
        assert f"monitor.pem: is not of the authority {mixed.ca}" in lines[0]
        assert "the certificate of monitor is not accepted there" in lines[1]


def test_certificates_without_identifiers_of_keys_are_accepted_as_zenoh_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From Python 3.13 on a client refuses them unless it is told not to."""
    add, identifiers = x509.CertificateBuilder.add_extension, (x509.SubjectKeyIdentifier, x509.AuthorityKeyIdentifier)

    def add_others(builder: x509.CertificateBuilder, extension: x509.ExtensionType, critical: bool) -> x509.CertificateBuilder:
        return builder if isinstance(extension, identifiers) else add(builder, extension, critical)

    monkeypatch.setattr(x509.CertificateBuilder, "add_extension", add_others)
    make_keys([*NAMES, "monitor"], tmp_path)
    scenario = scenario_at(f"tls/127.0.0.1:{free_port()}", tmp_path)
    with greeting(scenario, scenario.network.seeds[0]):
        assert not wrong(scenario)


def test_a_certificate_that_has_run_out_or_is_of_another_name_is_named_before_anybody_is_dialled(tmp_path: Path) -> None:
    make_keys([*NAMES], tmp_path)
    make_keys(["monitor"], tmp_path, days=-1 + 1)
    (tmp_path / "s2.pem").write_bytes((tmp_path / "s1.pem").read_bytes())
    (tmp_path / "s2.key").write_bytes((tmp_path / "s1.key").read_bytes())
    scenario = scenario_at(f"tls/127.0.0.1:{free_port()}", tmp_path)
    assert "monitor.pem: ran out on " in wrong(scenario)[0]
    assert wrong(scenario, "s2")[0] == f"{tmp_path}/s2.pem: is the certificate of s1, not of s2"


def test_the_certificate_is_that_of_the_name_also_where_the_file_has_no_roster_and_an_unknown_name_is_refused(tmp_path: Path) -> None:
    """With a wrong name that of the monitor was tried, and all was well."""
    make_keys(["s2", "monitor"], tmp_path)
    scenario = scenario_at(f"tls/127.0.0.1:{free_port()}", tmp_path)
    with pytest.raises(BadSetting, match=r"^--as s9: should be monitor, or one of s1, s2$"):
        wrong(scenario, "s9")
    roster = {"members": {}, "network": msgspec.structs.replace(scenario.network, admit=("s1", "s2"))}
    make_keys(["s2"], tmp_path, days=0, force=True)
    assert "s2.pem: ran out on" in wrong(msgspec.structs.replace(scenario, **roster), "s2")[0]


def test_a_name_that_the_others_do_not_admit_hears_nothing_and_is_told_what_that_may_mean(tmp_path: Path) -> None:
    make_keys([*NAMES], tmp_path)
    scenario = scenario_at(f"tls/127.0.0.1:{free_port()}", tmp_path)
    theirs = msgspec.structs.replace(scenario, network=msgspec.structs.replace(scenario.network, admit=("s1",)))
    with greeting(theirs, scenario.network.seeds[0]):
        assert wrong(scenario, "s2") == ["1 linked, and nobody says anything in run 'lab': they have another run.name, or do not admit s2"]


def test_another_run_another_wire_version_and_other_settings_are_named_with_both_values() -> None:
    scenario = scenario_at(f"tcp/127.0.0.1:{free_port()}")
    with greeting(scenario, scenario.network.seeds[0], wire=3, software="covey 9.9"):
        assert wrong(scenario) == ["s1: speaks wire version 3 (covey 9.9), this is 2: install the same release"]
    with greeting(scenario, scenario.network.seeds[0]):
        here = scenario_at(scenario.network.seeds[0], **{"run.name": "field"})
        assert wrong(here) == ["run.name = 'field': nobody is in this run; there is 'lab'"]
        here = scenario_at(scenario.network.seeds[0], **{"filter.gate": 3.5})
        assert wrong(here) == ["s1: filter.gate is 6.0 there and 3.5 here; should be the same everywhere"]
    with greeting(scenario, scenario.network.seeds[0], tick="x", heard=3):
        assert "s1: its Hello is refused" in wrong(scenario)[0]


def test_a_zenoh_router_of_others_is_no_swarm() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = live.open_session(NetworkSettings(mode="router", listen=(endpoint,)))
    try:
        [line] = wrong(scenario_at(endpoint))
    finally:
        router.close()
    assert line == "1 linked, and nobody is in any run: is that a Zenoh router, or a process of another kind?"


@pytest.mark.slow
def test_a_client_finds_those_who_are_behind_its_router() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = live.open_session(NetworkSettings(mode="router", listen=(endpoint,)))
    scenario = scenario_at(endpoint, **{"network.mode": "client"})
    try:
        with greeting(scenario, "tcp/127.0.0.1:0", seeds=(endpoint,)):
            found = [*check_network(scenario, "monitor", seconds=1.5)]
    finally:
        router.close()
    assert all(finding.right for finding in found) and found[-1].text == "run lab: found agent s1"


def test_without_seeds_the_command_says_what_is_missing() -> None:
    with pytest.raises(BadSetting, match=r"network\.seeds is empty"):
        [*check_network(resolve("quick"), "monitor")]


def test_the_command_prints_a_line_for_every_finding_and_fails_where_one_is_wrong(tmp_path: Path) -> None:
    seed = f"tcp/127.0.0.1:{free_port()}"
    words = ("check", "quick", "--network", "--set", f"network.seeds={json.dumps([seed])}")
    done = subprocess.run(
        [sys.executable, "-m", "deploy", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout.startswith(f"WRONG  {seed}: cannot be reached")
