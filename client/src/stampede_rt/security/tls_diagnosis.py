"""Says in one sentence why a connection with certificates failed.

gRPC mostly says "Socket closed", because its server ends a handshake without a reason. This module therefore repeats
the handshake with the standard library, which shows whether the server speaks TLS, and what is wrong with the server's
certificate. The module also checks the caller's own files.
"""

from __future__ import annotations

import socket
import ssl
from collections.abc import Mapping
from typing import NamedTuple

from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt.security.tls import TlsReader

CONNECT_SECONDS = 0.5
HANDSHAKE_SECONDS = 1.0
_FLIGHTS_MAX = 8  # messages of a handshake in memory; TLS 1.3 needs 3
_NOT_TLS = frozenset({"WRONG_VERSION_NUMBER", "HTTP_REQUEST", "RECORD_LAYER_FAILURE"})


def explain_refusal(
    target: str, tls: TlsReader | None, *, seconds: float = HANDSHAKE_SECONDS
) -> PermissionDenied | None:
    """Return why a caller with `tls` (None: plain text) cannot connect to `target`; None if TLS is not the reason.

    Blocks for at most about 2 * (CONNECT_SECONDS + `seconds`), and for the resolution of the name.
    """
    # Try twice. A server that is just stopping also closes the first connection, but takes no second one.
    if not _reason_of_refusal(target, tls, seconds) or not (reason := _reason_of_refusal(target, tls, seconds)):
        return None
    return PermissionDenied(reason, reason="UNAUTHENTICATED", metadata={"target": target})


def _reason_of_refusal(target: str, tls: TlsReader | None, seconds: float) -> str:
    place = _place(target)
    if place is None:
        return ""
    try:
        with socket.create_connection(place, CONNECT_SECONDS) as connection:
            connection.settimeout(seconds)
            return _try_plain(connection, target) if tls is None else _try_tls(connection, place[0], target, tls)
    except (OSError, UnicodeError):  # no server, or no answer: TLS is not the reason
        return ""


def _place(target: str) -> tuple[str, int] | None:
    host, _, port = target.rpartition(":")
    if target.startswith("unix:") or not port.isdecimal():
        return None
    return host.removeprefix("[").removesuffix("]"), int(port)


def _try_plain(connection: socket.socket, target: str) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE  # safe, because this only asks whether the server speaks TLS, and sends nothing
    context.set_alpn_protocols(["h2"])
    try:
        with context.wrap_socket(connection):
            return (
                f"{target} asks for certificates (TLS), and this caller has none; name yours with connect(tls=...) or "
                "$STAMPEDE_TLS_CA, $STAMPEDE_TLS_CERTIFICATE and $STAMPEDE_TLS_KEY (services: --tls-ca, "
                "--tls-certificate, --tls-key)"
            )
    except ssl.SSLError:
        return ""


def _try_tls(connection: socket.socket, host: str, target: str, tls: TlsReader) -> str:
    context = _context(tls)
    try:
        with context.wrap_socket(connection, server_hostname=host) as secured:
            answered = secured.recv(1)  # a server that accepts the certificate speaks first (HTTP/2 SETTINGS)
    except ssl.SSLCertVerificationError as error:
        return _fault_of_server_certificate(error, target, tls)
    except ssl.SSLError as error:
        if error.reason not in _NOT_TLS:
            return ""
        return f"{target} speaks plain text, not TLS; leave the certificates out, or give that service certificates"
    except ConnectionError:
        answered = b""
    return "" if answered else _fault_of_caller(target, tls)


def _context(tls: TlsReader) -> ssl.SSLContext:
    """Return a TLS context like the context of a gRPC client."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    ca, certificate, key = tls.files.paths()
    context.load_verify_locations(cafile=ca)
    context.load_cert_chain(certificate, key)
    context.set_alpn_protocols(["h2"])
    return context


class Validity(NamedTuple):
    """The instants from which and until which a certificate is valid, in seconds since the epoch."""

    begins_s: float
    ends_s: float


def certificate_validity(target: str, tls: TlsReader) -> Validity | None:
    """Return when the certificate of the server at `target` begins and ends; None if no handshake succeeds.

    Blocks for at most CONNECT_SECONDS and a few HANDSHAKE_SECONDS, and for the resolution of the name.
    """
    place = _place(target)
    if place is None:
        return None
    try:
        with socket.create_connection(place, CONNECT_SECONDS) as connection:
            connection.settimeout(HANDSHAKE_SECONDS)
            with _context(tls).wrap_socket(connection, server_hostname=place[0]) as secured:
                shown = secured.getpeercert() or {}
    except (OSError, UnicodeError):
        return None
    return validity_of(shown)


def validity_of(shown: Mapping[str, object]) -> Validity | None:
    """Return when a certificate begins and ends. `shown` is the result of `getpeercert`; None if it has no dates."""
    begin, end = shown.get("notBefore"), shown.get("notAfter")
    if not isinstance(begin, str) or not isinstance(end, str):
        return None
    return Validity(ssl.cert_time_to_seconds(begin), ssl.cert_time_to_seconds(end))


def _fault_of_server_certificate(error: ssl.SSLCertVerificationError, target: str, tls: TlsReader) -> str:
    text = error.verify_message
    if "expired" in text:
        return f"the certificate of {target} has expired; issue it anew (stampede certs issue)"
    if "not yet valid" in text:
        return f"the certificate of {target} is not valid yet; look at the clocks of both machines"
    if "mismatch" in text or "doesn't match" in text or "not valid for" in text:
        return f"the certificate of {target} is for other addresses ({text}); issue it with --address for this address"
    if "purpose" in text:
        return f"the certificate of {target} is not for a service ({text})"
    return (
        f"the certificate of {target} is of an authority that {tls.files.ca} does not contain ({text}); "
        "use the CA file of that cluster"
    )


def _fault_of_caller(target: str, tls: TlsReader) -> str:
    """Explain why a server closed the connection after it had seen this caller's certificate."""
    own = tls.files.certificate
    try:
        check_own_certificate(tls)
    except PermissionDenied as error:
        return f"{target} refused this caller: {error.message}"
    return (
        f"{target} refused the certificate {own}: no authority that issued it is trusted there; "
        "use a certificate of that cluster"
    )


def check_own_certificate(tls: TlsReader) -> dict[str, object]:
    """Check this caller's certificate as a server would. Returns it in the form of the standard library.

    The check is a handshake in memory, in which this process is both client and server. Raises PermissionDenied with
    the fault, InvalidArgument if the handshake does not end.
    """
    ca, certificate, key = tls.files.paths()
    server_side = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server_side.verify_mode = ssl.CERT_REQUIRED
    server_side.load_verify_locations(cafile=ca)
    client_side = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client_side.check_hostname = False
    client_side.verify_mode = ssl.CERT_NONE
    for context in (server_side, client_side):
        context.load_cert_chain(certificate, key)
    try:
        return _shake_hands(client_side, server_side)
    except ssl.SSLCertVerificationError as error:
        raise PermissionDenied(
            _fault_of_own_certificate(error.verify_message, tls), reason="UNAUTHENTICATED"
        ) from error


def _fault_of_own_certificate(text: str, tls: TlsReader) -> str:
    own, ca = tls.files.certificate, tls.files.ca
    if "expired" in text:
        return f"the certificate {own} has expired; issue it anew (stampede certs issue)"
    if "not yet valid" in text:
        return f"the certificate {own} is not valid yet; look at this machine's clock"
    return f"the certificate {own} is not of an authority in {ca} ({text})"


def _shake_hands(client_side: ssl.SSLContext, server_side: ssl.SSLContext) -> dict[str, object]:
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = client_side.wrap_bio(to_client, to_server)
    server = server_side.wrap_bio(to_server, to_client, server_side=True)
    for _ in range(_FLIGHTS_MAX):
        done = [_step(client), _step(server)]
        if all(done):
            return dict(server.getpeercert() or {})
    raise InvalidArgument(
        "the certificate cannot be checked: the handshake does not end; issue it anew (stampede certs issue)"
    )


def _step(side: ssl.SSLObject) -> bool:
    try:
        side.do_handshake()
    except ssl.SSLWantReadError:
        return False
    return True
