"""Checks of the network endpoints of a process, of its certificate files, and of the loopback interface.

Any endpoint on this machine is allowed. An endpoint beyond this machine needs TLS, or the setting `network.insecure`.
"""

import os
import re
import socket
import ssl

from msgspec import structs

from protocol.settings import BadSetting, NetworkSettings

ENCRYPTED = ("tls/", "quic/")
ENDPOINT_FORM = re.compile(r"^(?:(?:tcp|udp|tls|quic|ws)/[^\s/?#]+:(\d{1,5})(?:[?#]\S+)?|(?!tcp|udp|tls|quic|ws)[a-z-]+/\S+)\Z")
LARGEST_PORT = 65535
PEM_CERTIFICATE = re.compile("-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL)
COMMON_NAME = re.compile(rb"\x06\x03\x55\x04\x03[\x0c\x13\x14\x16](.)", re.DOTALL)  # DER: its identifier, a kind of string, and the length
SAFE_ENDPOINT = re.compile(r"^(tls/|quic/|unixsock-stream/|[a-z]+/(127\.\d+\.\d+\.\d+|localhost|\[::1\]):\d+)")


def check_endpoints(settings: NetworkSettings) -> None:
    """Raise BadSetting for an endpoint that breaks a rule.

    An endpoint must be readable. Without `insecure` it must not leave this machine without TLS. It is encrypted exactly when
    certificates are given.
    """
    default = NetworkSettings().listen
    if settings.encrypted and settings.mode != "peer":
        raise BadSetting(f"network.mode = {settings.mode}: behind a router no certificate says who speaks; should be peer")
    for field in ("listen", "seeds"):
        for endpoint in getattr(settings, field):
            setting = f"network.{field} = {endpoint!r}"
            form = ENDPOINT_FORM.match(endpoint)
            if form is None or int(form[1] or 0) > LARGEST_PORT:
                raise BadSetting(f"{setting}: should read protocol/address:port, such as tcp/127.0.0.1:0; a port is at most {LARGEST_PORT}")
            if not settings.insecure and not SAFE_ENDPOINT.match(endpoint):
                raise BadSetting(f"{setting}: leaves this machine without TLS; use tls/..., a loopback address, or network.insecure = true")
            if endpoint.startswith(ENCRYPTED) and not settings.encrypted:
                raise BadSetting(f"{setting}: needs certificates; `covey keys` makes them, --keys DIR uses them")
            if settings.encrypted and not endpoint.startswith(ENCRYPTED) and (field, (endpoint,)) != ("listen", default):
                raise BadSetting(f"{setting}: should be tls/address:port, for network.ca asks for certificates")


def check_loopback() -> None:
    """Raise BadSetting when this machine cannot reach itself."""
    try:
        with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()[:2], timeout=5.0):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadSetting(f"127.0.0.1 cannot be reached: {reason}; `ip link set lo up` switches the loopback interface on") from None


def check_files(settings: NetworkSettings, name: str) -> None:
    """Raise BadSetting when a file of mutual TLS is missing for the owner of that common name, or is not what it should be."""
    if not settings.encrypted:
        return
    files = settings.files(name)
    for field, file in files.items():
        try:
            with open(file, "rb"):
                pass
        except OSError as error:
            reason = "is not given; ca, certificate and key go together" if not file else error.strerror
            raise BadSetting(f"network.{field} = {file!r}: {reason}; `covey keys` makes the certificates of a swarm") from None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(files["ca"])
    except ssl.SSLError:
        raise BadSetting(
            f"network.ca = {files['ca']!r}: should be the certificate of an authority, such as the ca.pem of `covey keys`"
        ) from None
    try:
        context.load_cert_chain(files["certificate"], files["key"], password="")  # without a password it would ask for one
    except (ssl.SSLError, ValueError):
        right = f"should be the key, without a password, of the certificate {files['certificate']}"
        raise BadSetting(f"network.key = {files['key']!r}: {right}") from None


def check_owner(settings: NetworkSettings, name: str) -> None:
    """Raise BadSetting when the certificate is that of another name: all peers would drop what its holder says, without a word."""
    if not settings.encrypted:
        return
    file = settings.files(name)["certificate"]
    with open(file, encoding="utf-8") as text:
        owners = common_names(text.read())
    if owners and name not in owners:
        raise BadSetting(f"network.certificate = {file!r}: is not the certificate of {name}, but names {', '.join(sorted(owners))}")


def common_names(certificate: str) -> set[str]:
    """The common names in the first certificate of a PEM file: of its owner, and of the authority that has signed it."""
    der = b"".join(map(ssl.PEM_cert_to_DER_cert, PEM_CERTIFICATE.findall(certificate)[:1]))
    return {der[found.end() : found.end() + found[1][0]].decode(errors="replace") for found in COMMON_NAME.finditer(der)}


def own_endpoints(settings: NetworkSettings) -> tuple[str, ...]:
    """The endpoints to listen on: those of the settings; with certificates the default endpoint is encrypted."""
    if settings.encrypted and settings.listen == NetworkSettings().listen:
        return (f"tls/{settings.listen[0].partition('/')[2]}",)
    return settings.listen


def on_any_port(settings: NetworkSettings) -> NetworkSettings:
    """The same settings with any free port; for a session that is opened anew while the old one still holds its port."""
    return structs.replace(settings, listen=tuple(re.sub(r":\d+$", ":0", endpoint) for endpoint in settings.listen))


def endpoint_error(settings: NetworkSettings, text: str) -> BadSetting:
    """Zenoh's complaint about endpoints that cannot be used, as a BadSetting of one line."""
    text = re.sub(r" at \S+\.rs:\d+\.?", "", text).strip()
    hint = "the port is in use; choose a free one, or port 0 for any" if "already in use" in text else text
    return BadSetting(f"network.listen = {', '.join(settings.listen)}: {hint}")


_RESERVED: list[socket.socket] = []  # UDP sockets that mark the ports that `free_port` has returned, kept until the process ends
LOWEST_PORT, HIGHEST_PORT = 20000, 32000  # of `free_port`
MARK_BELOW = HIGHEST_PORT - LOWEST_PORT  # the UDP port of a mark is so much lower: a UDP or QUIC endpoint may listen at the port itself


def free_port() -> int:
    """A free TCP port on 127.0.0.1, below the range that the kernel gives to outgoing connections.

    Some time passes until another process listens on it. So this process keeps a UDP port, `MARK_BELOW` lower, which marks the port as
    taken for every other call.
    """
    span = HIGHEST_PORT - LOWEST_PORT
    start = int.from_bytes(os.urandom(4), "little")
    for step in range(span):
        port = LOWEST_PORT + (start + 7 * step) % span
        reserved = socket.socket(type=socket.SOCK_DGRAM)
        try:
            reserved.bind(("127.0.0.1", port - MARK_BELOW))
            with socket.socket() as probe:
                probe.bind(("127.0.0.1", port))
        except OSError:
            reserved.close()
            continue
        _RESERVED.append(reserved)
        return port
    raise BadSetting(f"no free port between {LOWEST_PORT} and {HIGHEST_PORT} on 127.0.0.1")
