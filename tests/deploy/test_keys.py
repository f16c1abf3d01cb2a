"""`covey keys`: one authority, a certificate for each name, and nothing is overwritten by accident."""

import ssl
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from deploy.cli.keys import keys
from deploy.live.certificates import make_keys, work_tree
from protocol.settings import BadSetting


def certificate(file: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(file.read_bytes())


def mode(file: Path) -> int:
    return stat.S_IMODE(file.stat().st_mode)


def test_each_name_gets_a_certificate_that_the_authority_has_signed_and_a_key_that_only_its_owner_may_read(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    assert make_keys(["s1", "a_b.c"], folder, ("10.0.0.7", "robot-7.example")) == [folder / "s1.pem", folder / "a_b.c.pem"]
    authority = certificate(folder / "ca.pem")
    for name in ("s1", "a_b.c"):
        mine = certificate(folder / f"{name}.pem")
        mine.verify_directly_issued_by(authority)
        assert [part.value for part in mine.subject.get_attributes_for_oid(NameOID.COMMON_NAME)] == [name]
        public = mine.public_key()
        assert isinstance(public, ec.EllipticCurvePublicKey) and public.curve.name == "secp256r1"
        names = mine.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        assert names.get_values_for_type(x509.DNSName) == [name, "localhost", "robot-7.example"]
        assert [str(address) for address in names.get_values_for_type(x509.IPAddress)] == ["127.0.0.1", "::1", "10.0.0.7"]
        usages = set(mine.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
        assert usages == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
        assert not mine.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        now = datetime.now(UTC)
        assert mine.not_valid_before_utc < now - timedelta(hours=1) and mine.not_valid_after_utc > now + timedelta(days=700)
        context = ssl.create_default_context(cafile=str(folder / "ca.pem"))
        context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")  # raises when they do not belong together
    assert {mode(file) for file in folder.glob("*.key")} == {0o600}
    assert mode(folder) == 0o700
    assert sorted(file.name for file in folder.iterdir()) == [
        ".gitignore",
        "a_b.c.key",
        "a_b.c.pem",
        "ca.key",
        "ca.pem",
        "s1.key",
        "s1.pem",
    ]


def test_a_client_that_checks_all_that_a_certificate_should_hold_takes_ours(tmp_path: Path) -> None:
    """Python does so from 3.13 on; before, with this flag."""
    make_keys(["s1"], tmp_path)
    client, server = ssl.create_default_context(cafile=str(tmp_path / "ca.pem")), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    client.verify_flags |= ssl.VERIFY_X509_STRICT
    server.load_cert_chain(tmp_path / "s1.pem", tmp_path / "s1.key")
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    dialling = client.wrap_bio(to_client, to_server, server_hostname="localhost")
    listening = server.wrap_bio(to_server, to_client, server_side=True)
    for side in (dialling, listening):
        with pytest.raises(ssl.SSLWantReadError):  # it has said its part
            side.do_handshake()
    dialling.do_handshake()  # raises if it refuses the certificate
    assert ("commonName", "s1") in [pair[0] for pair in dialling.getpeercert()["subject"]]  # type: ignore[index]


def test_a_later_name_is_signed_by_the_same_authority_and_nothing_is_overwritten_unless_forced(tmp_path: Path) -> None:
    make_keys(["s1"], tmp_path)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(BadSetting, match=r"s1\.pem: exists; --force"):
        make_keys(["s2", "s1"], tmp_path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before, "a refusal changes nothing"
    make_keys(["s2"], tmp_path)
    make_keys(["s1"], tmp_path, force=True)
    assert (tmp_path / "ca.pem").read_bytes() == before["ca.pem"]
    assert (tmp_path / "s1.pem").read_bytes() != before["s1.pem"]
    for name in ("s1", "s2"):
        certificate(tmp_path / f"{name}.pem").verify_directly_issued_by(certificate(tmp_path / "ca.pem"))
    assert mode(tmp_path / "s1.key") == 0o600


def test_an_authority_that_is_not_whole_is_refused(tmp_path: Path) -> None:
    make_keys(["s1"], tmp_path)
    other = ec.generate_private_key(ec.SECP256R1())
    form = (serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    (tmp_path / "ca.key").write_bytes(other.private_bytes(*form))
    with pytest.raises(BadSetting, match=r"ca\.key: is not the key of ca\.pem"):
        make_keys(["s2"], tmp_path)
    (tmp_path / "ca.key").write_text("rubbish")
    with pytest.raises(BadSetting, match="no authority of ours"):
        make_keys(["s2"], tmp_path)
    (tmp_path / "ca.key").unlink()
    with pytest.raises(BadSetting, match=r"ca\.key: is missing"):
        make_keys(["s2"], tmp_path)


@pytest.mark.parametrize("name", ["ca", "", "a/b", "s 1", "x" * 65])
def test_a_name_that_cannot_be_one_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match=r"name .*: should be 1 to 64"):
        make_keys([name], tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_command_knows_the_names_of_a_scenario_and_complains_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert keys([], "quick", tmp_path, (), 10, False) == 0
    assert "9 certificates" in capsys.readouterr().out
    assert {file.stem for file in tmp_path.glob("*.pem")} == {"ca", "world", "monitor", "operator", "s1", "s2", "s3", "s4", "s5", "s6"}
    for names, scenario, hosts, days, complaint in [
        ([], None, (), 10, "either names"),
        (["s9"], "quick", (), 10, "either names"),
        (["s9"], None, ("no such host",), 10, "--host no such host: should be"),
        (["s9"], None, (), 0, "--days 0: should be"),
    ]:
        with pytest.raises(BadSetting, match=complaint) as caught:
            keys(names, scenario, tmp_path, hosts, days, False)
        assert "\n" not in str(caught.value)
    (tmp_path / "file").write_text("")
    with pytest.raises(BadSetting, match="--into"):
        keys(["s9"], None, tmp_path / "file", (), 10, False)


def test_keys_are_kept_out_of_git_and_out_of_work_trees_unless_that_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / ".git").mkdir()
    folder = tmp_path / "deep" / "keys"
    with pytest.raises(
        BadSetting, match=r"lies in the git work tree .*, where ca\.key is soon published; take another folder, or --in-git"
    ):
        make_keys(["s1"], folder)
    assert not folder.exists()
    (tmp_path / "clone" / ".git").mkdir(parents=True)
    assert work_tree(tmp_path / "clone" / ".." / "keys") == tmp_path.resolve()
    (tmp_path / ".git").rename(tmp_path / "no-git")
    assert work_tree(tmp_path / "clone" / ".." / "keys") is None  # as docs/how-to/many-machines.md types it in a clone
    (tmp_path / "no-git").rename(tmp_path / ".git")
    make_keys(["s1"], folder, in_git=True)
    assert (folder / ".gitignore").read_text() == "*\n"


@pytest.mark.parametrize(
    ("before", "after"),
    [("build/\n", "build/\n*.key\n"), ("build/", "build/\n*.key\n"), ("*.key\nbuild/\n", "*.key\nbuild/\n"), ("*\n", "*\n")],
)
def test_somebodys_own_list_of_ignored_files_is_kept_and_ignores_the_keys(tmp_path: Path, before: str, after: str) -> None:
    (tmp_path / ".gitignore").write_text(before)
    make_keys(["s1"], tmp_path)
    make_keys(["s2"], tmp_path)
    assert (tmp_path / ".gitignore").read_text() == after
