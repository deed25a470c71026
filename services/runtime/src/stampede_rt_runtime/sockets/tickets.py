"""Tickets. A ticket proves over a local socket which certificate the caller has shown over gRPC.

TLS proves a certificate for one connection. A caller gets a ticket over such a connection, and sends it at the
beginning of each stream over a socket. Only processes of the same user can open the socket, and such a process could
read the caller's key as well as its ticket. So the stream itself needs no TLS (decision 0165).
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

TICKETS_MAX = 4096
TICKET_BYTES = 32
_CERTIFICATE = "x509_pem_cert"
_KEPT = (_CERTIFICATE, "peer_uri")

AuthContext = Mapping[str, Iterable[bytes]]
"""The properties of a TLS connection, as `grpc.ServicerContext.auth_context` has them."""
CertificateFacts = Mapping[str, Sequence[bytes]]
"""The properties that identify the certificate."""


class SocketTickets:
    """The tickets of one service. Each certificate has one, for as long as the certificate and the process live.

    The end of a certificate and its revocation are checked for each stream, as over gRPC. If TICKETS_MAX valid
    certificates have tickets, callers with other certificates get none, and use gRPC.
    """

    def __init__(
        self, end_of: Callable[[bytes], int] | None = None, time_unix_nano: Callable[[], int] = time.time_ns
    ) -> None:
        """`end_of`: returns the end of a certificate in PEM form."""
        self._end_of = end_of or _end_of
        self._time_unix_nano = time_unix_nano
        self._tickets: dict[bytes, bytes] = {}  # by certificate, in the order of issue
        self._certificates: dict[bytes, tuple[CertificateFacts, int]] = {}  # by ticket, with the end of the certificate

    def issue(self, auth: AuthContext) -> bytes | None:
        """The ticket for the certificate of a connection; empty if it has no certificate. None: there are too many."""
        certificate = next(iter(auth.get(_CERTIFICATE, ())), b"")
        if not certificate or certificate in self._tickets:
            return self._tickets.get(certificate, b"")
        self._forget_ended()
        if len(self._tickets) >= TICKETS_MAX:
            return None
        ticket = self._tickets[certificate] = secrets.token_bytes(TICKET_BYTES)
        self._certificates[ticket] = {key: tuple(auth[key]) for key in _KEPT if key in auth}, self._end_of(certificate)
        return ticket

    def certificate_of(self, ticket: bytes) -> CertificateFacts:
        """The certificate of the caller with this ticket; nothing for a ticket that this service has not issued."""
        found = self._certificates.get(ticket)
        return {} if found is None else found[0]

    def _forget_ended(self) -> None:
        """Forget the tickets that were issued first, up to one whose certificate has not ended."""
        now = self._time_unix_nano()
        while self._tickets and self._certificates[next(iter(self._tickets.values()))][1] <= now:
            del self._certificates[self._tickets.pop(next(iter(self._tickets)))]


def _end_of(certificate: bytes) -> int:
    from stampede_rt_runtime.certificates import serial_and_end  # not at the top: needed only with certificates

    return serial_and_end(certificate)[1]
