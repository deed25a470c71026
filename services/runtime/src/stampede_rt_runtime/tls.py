"""A service's certificates: loaded and checked at the start, used by its server, read again when the files change."""

from __future__ import annotations

import logging
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import grpc

from stampede_rt.errors import PermissionDenied
from stampede_rt.security.tls import TlsFiles, TlsMaterial, TlsReader
from stampede_rt.security.tls_contexts import server_context
from stampede_rt.security.tls_diagnosis import check_own_certificate
from stampede_rt_runtime.identity import Identity, Role

logger = logging.getLogger(__name__)

SOON = timedelta(days=14)  # a service warns at its start if its certificate ends within this time
_ANYWHERE = ("0.0.0.0", "::")  # wildcard addresses: no caller uses them, so no certificate names them


@dataclass(frozen=True, slots=True)
class ServiceTls:
    """The certificates with which a service listens and calls, and the identity in its own certificate."""

    reader: TlsReader
    identity: Identity
    addresses: tuple[str, ...]

    def ends_unix_s(self) -> float:
        """The end of the present certificate, in seconds since the epoch."""
        from stampede_rt_runtime.certificates import describe  # not at the top: see `load_tls`

        return float(describe(self.reader.current().certificate)[0].not_after.timestamp())

    def server_credentials(self) -> grpc.ServerCredentials:
        """The server's credentials. They require a certificate of every caller.

        New connections use the files' present contents.
        """
        given = self.reader.current()

        def newest() -> grpc.ServerCertificateConfiguration | None:
            nonlocal given
            found = self.reader.current()
            if found is given:
                return None  # keeps the former contents
            given = found
            return _configuration(found)

        return grpc.dynamic_ssl_server_credentials(
            _configuration(given),
            newest,  # type: ignore[arg-type, unused-ignore]  # None is documented: nothing has changed
            require_client_authentication=True,
        )

    def socket_context(self) -> Callable[[], ssl.SSLContext]:
        """A function that returns the TLS of a new connection over a socket, with the files' present contents."""
        material = self.reader.current()
        made = server_context(material)

        def newest() -> ssl.SSLContext:
            nonlocal material, made
            found = self.reader.current()
            if found is not material:
                material, made = found, server_context(found)
            return made

        return newest

    def require_name(self, name: str, flag: str) -> None:
        """Raises PermissionDenied if the service's configured name differs from the name in its certificate."""
        if name != self.identity.name:
            raise PermissionDenied(
                f"{flag} is {name!r}, but the certificate {self.reader.files.certificate} belongs to "
                f"{self.identity}; give the service {flag} {self.identity.name}, or issue a certificate for {name!r}"
            )

    def require_address(self, target: str) -> None:
        """Raises PermissionDenied if callers of `target`, the advertised address, would refuse the certificate."""
        host = target.rpartition(":")[0].strip("[]")
        if target.startswith("unix:") or host.lower() in (*_ANYWHERE, *map(str.lower, self.addresses)):
            return
        raise PermissionDenied(
            f"others call this service at {host}, but the certificate {self.reader.files.certificate} is for "
            f"{', '.join(self.addresses)}; issue it with `stampede certs issue --address {host}`, or give "
            "another address in --advertise"
        )


def _configuration(material: TlsMaterial) -> grpc.ServerCertificateConfiguration:
    return grpc.ssl_server_certificate_configuration([(material.key, material.certificate)], material.ca)


def load_tls(files: TlsFiles, role: Role) -> ServiceTls:
    """The certificates of a service of that role. Reads files.

    Raises PermissionDenied if they are missing, expired, of another authority or role, or do not belong together.
    """
    # not at the top: the import takes a tenth of a service's start
    from stampede_rt_runtime.certificates import describe

    reader = TlsReader(files)
    check_own_certificate(reader)
    own = describe(reader.current().certificate)[0]
    if own.identity is None or own.identity.role is not role:
        who = str(own.identity) if own.identity else f"{own.subject}, without a role"
        raise PermissionDenied(
            f"the certificate {files.certificate} belongs to {who}, but this service is a {role}; "
            f"issue it with `stampede certs issue --role {role}`"
        )
    now = datetime.now(UTC)
    if own.ends_soon(now, SOON):
        left = str(own.not_after - now).partition(".")[0]
        logger.warning(
            "the certificate %s ends in %s; renew it", files.certificate, left, extra={"event": "certificate_ends_soon"}
        )
    return ServiceTls(reader, own.identity, own.addresses)
