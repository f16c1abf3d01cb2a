"""A certificate authority of one swarm and a certificate for each of its names, for mutual TLS.

keys/ca.pem     the authority's certificate, which all processes trust
keys/ca.key     its private key; no process of a run reads it
keys/s3.pem     the certificate of s3: common name s3, for TLS servers and clients
keys/s3.key     its private key
keys/.gitignore keeps all of them out of git; where there is one already, it keeps the private keys out

The authority's key is not made inside a git work tree unless that is asked for.
"""

import contextlib
import ipaddress
import os
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from protocol.keys import NAME
from protocol.settings import BadSetting, NetworkSettings

AUTHORITY = "ca"
AUTHORITY_DAYS = 3650
SLACK = timedelta(days=1)  # clocks of machines differ
HERE = ("localhost", "127.0.0.1", "::1")
HOST = re.compile(r"^(?=.{1,253}\Z)[A-Za-z0-9_]([A-Za-z0-9_-]{0,61}[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?)*\Z")


def make_keys(
    names: list[str], folder: Path, hosts: tuple[str, ...] = (), *, days: int = 730, force: bool = False, in_git: bool = False
) -> list[Path]:
    """The certificates made, one for each name, signed by the folder's authority, which is made when it is missing.

    `hosts` are addresses beyond loopback under which the owners listen. Raises BadSetting for a name or a host that cannot be one. It also
    does for a file that exists, unless `force`, and for a folder in a git work tree, unless `in_git`.
    """
    tree = work_tree(folder)
    if tree is not None and not in_git:
        raise BadSetting(
            f"--into {folder}: lies in the git work tree {tree}, where {AUTHORITY}.key is soon published; take another folder, or --in-git"
        )
    for name in names:
        if not NAME.match(name) or name == AUTHORITY:
            raise BadSetting(f"name {name!r}: should be 1 to 64 letters, digits, or any of _ . - and not {AUTHORITY!r}")
        for file in (folder / f"{name}.pem", folder / f"{name}.key"):
            if file.exists() and not force:
                raise BadSetting(f"{file}: exists; --force makes it anew")
    alternatives = [_alternative(host) for host in (*HERE, *hosts)]
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _keep_out_of_git(folder / ".gitignore")
        authority, signing_key = _authority(folder)
        return [_certify(name, folder, alternatives, authority, signing_key, days) for name in dict.fromkeys(names)]
    except OSError as error:
        raise BadSetting(f"--into {folder}: {error.strerror}") from None


def _keep_out_of_git(ignored: Path) -> None:
    """Let git ignore the folder, or at least the private keys in it where somebody's own list is there."""
    rules = ignored.read_text(encoding="utf-8") if ignored.exists() else ""
    if not rules:
        ignored.write_text("*\n", encoding="utf-8")
    elif not {"*", "*.key"} & {line.strip() for line in rules.splitlines()}:
        with ignored.open("a", encoding="utf-8") as out:
            out.write("*.key\n" if rules.endswith("\n") else "\n*.key\n")


def work_tree(folder: Path) -> Path | None:
    """The git work tree in which a folder lies; `..` and links are followed first."""
    here = folder.resolve()
    return next((path for path in (here, *here.parents) if (path / ".git").exists()), None)


def _alternative(host: str) -> x509.GeneralName:
    """A subject alternative name: an IP address or a host name."""
    with contextlib.suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(host))
    if not HOST.match(host):
        raise BadSetting(f"--host {host}: should be an IP address or a host name")
    return x509.DNSName(host)


def _authority(folder: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """The folder's authority and its key, made when there is neither."""
    certificate_file, key_file = folder / f"{AUTHORITY}.pem", folder / f"{AUTHORITY}.key"
    if certificate_file.exists() or key_file.exists():
        return _read_authority(certificate_file, key_file)
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "covey authority")])
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    builder = _builder(subject, subject, key, key, AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True).add_extension(usage, critical=True)
    certificate = builder.sign(key, hashes.SHA256())
    _write(key_file, _pem(key), 0o600)
    _write(certificate_file, certificate.public_bytes(serialization.Encoding.PEM), 0o644)
    return certificate, key


def _read_authority(certificate_file: Path, key_file: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    try:
        certificate = x509.load_pem_x509_certificate(certificate_file.read_bytes())
        key = serialization.load_pem_private_key(key_file.read_bytes(), None)
    except FileNotFoundError as error:
        raise BadSetting(f"{error.filename}: is missing; an authority is the pair {certificate_file.name}, {key_file.name}") from None
    except (ValueError, TypeError) as error:
        raise BadSetting(f"{certificate_file.parent}: no authority of ours: {error}") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise BadSetting(f"{key_file}: is not the key of {certificate_file.name}")
    return certificate, key


def _certify(
    name: str,
    folder: Path,
    alternatives: list[x509.GeneralName],
    authority: x509.Certificate,
    signing_key: ec.EllipticCurvePrivateKey,
    days: int,
) -> Path:
    """Write the key and the certificate of a name; the certificate's file."""
    key = ec.generate_private_key(ec.SECP256R1())
    own = [x509.DNSName(name)] if HOST.match(name) else []
    usages = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    certificate = (
        _builder(subject, authority.subject, key, signing_key, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([*own, *alternatives]), critical=False)
        .add_extension(usages, critical=False)
        .sign(signing_key, hashes.SHA256())
    )
    _write(folder / f"{name}.key", _pem(key), 0o600)
    file = folder / f"{name}.pem"
    _write(file, certificate.public_bytes(serialization.Encoding.PEM), 0o644)
    return file


def wrong_with_certificate(network: NetworkSettings, name: str) -> Iterator[str]:
    """A line for each fault of the certificate of `name`: not in force, of another name, of an authority that is not trusted here.

    Certificates between it and the authority follow it in its file. The last of them must be of a trusted authority; the links between
    them are not looked at.
    """
    files = network.files(name)
    chain, authorities = (x509.load_pem_x509_certificates(Path(files[field]).read_bytes()) for field in ("certificate", "ca"))
    certificate, file = chain[0], files["certificate"]
    common = ", ".join(str(part.value) for part in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME))
    ends, now = certificate.not_valid_after_utc, datetime.now(UTC)
    if common != name:
        yield f"{file}: is the certificate of {common}, not of {name}"
    if not certificate.not_valid_before_utc <= now <= ends:
        yield f"{file}: ran out on {ends:%Y-%m-%d}, or this machine's clock is wrong: {now:%Y-%m-%d %H:%M} UTC"
    if not any(_is_issued_by(chain[-1], authority) for authority in authorities):
        yield f"{file}: is not of the authority {files['ca']}"


def _is_issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, signing_key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    """What all our certificates hold. With the identifiers of both keys strict clients, such as Python 3.13's, take them too."""
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - SLACK)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signing_key.public_key()), critical=False)
    )


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())


def _write(file: Path, content: bytes, mode: int) -> None:
    """Write a file that never exists with wider permissions than these, nor half written."""
    fresh = file.with_name(f"{file.name}.{os.getpid()}.new")
    descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as out:
        out.write(content)
    fresh.replace(file)
