"""The caller of a call: its credential, its name and its roles. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass
from enum import StrEnum

from stampede_rt_runtime.identity import SERVICES, Identity, Role


class CallerKind(StrEnum):
    """The kind of credential that proves who the caller is."""

    CERTIFICATE = "certificate"
    TOKEN = "token"
    CLIENT_SECRET = "client secret"
    CLUSTER_SECRET = "cluster secret"
    NOBODY = "nobody"  # the service asks for no credential


ALL_ROLES = frozenset(Role)
UNJUDGED = SERVICES | {Role.OPERATOR}  # no rule restricts a caller with one of these roles
_NAMELESS = {
    CallerKind.CLIENT_SECRET: ("@clients", "a holder of the clients' secret"),
    CallerKind.CLUSTER_SECRET: ("@cluster", "a holder of the cluster's secret"),
    CallerKind.NOBODY: ("@anyone", "a caller without a credential"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Caller:
    """One caller. `name`: its name in rules. Names that begin with "@" occur in no certificate or token.

    `serial` identifies the certificate or token among others of the same name; empty: there is none. `ends_unix_nano`:
    the end of its validity; 0: it has no end. `connection`: the certificate that opened the connection, if a token came
    with it; the caller is valid only as long as both credentials are valid.
    """

    kind: CallerKind
    roles: frozenset[Role]
    name: str
    serial: str = ""
    ends_unix_nano: int = 0
    connection: Caller | None = None

    def __str__(self) -> str:
        if self.kind in _NAMELESS:
            return _NAMELESS[self.kind][1]
        return f"{' and '.join(sorted(self.roles))} {self.name}"

    @property
    def is_judged(self) -> bool:
        """Whether rules decide what the caller may do. Services of the cluster, and operators, may do everything."""
        return not self.roles & UNJUDGED

    @property
    def by_each_credential(self) -> Iterator[Caller]:
        """The caller by each of its credentials: this credential, and the connection's certificate."""
        yield self
        if self.connection is not None:
            yield self.connection

    def revoked_among(self, serials: Set[str]) -> Caller | None:
        """The caller by the first credential whose serial number is among `serials`; None: there is none."""
        return next((one for one in self.by_each_credential if one.serial in serials), None)

    def ended_by(self, now_unix_nano: int) -> Caller | None:
        """The caller by the first credential whose validity has ended; None: there is none."""
        return next((one for one in self.by_each_credential if 0 < one.ends_unix_nano <= now_unix_nano), None)

    @property
    def first_end_unix_nano(self) -> int:
        """The end of the credential that ends first; 0: no credential has an end."""
        return min((one.ends_unix_nano for one in self.by_each_credential if one.ends_unix_nano), default=0)

    @property
    def may_end(self) -> bool:
        """Whether a credential of the caller may be revoked, or has an end."""
        return any(one.serial or one.ends_unix_nano for one in self.by_each_credential)


ANYONE = Caller(kind=CallerKind.NOBODY, roles=ALL_ROLES, name="@anyone")


def by_secret(*, of_cluster: bool) -> Caller:
    """The caller that brings the cluster's secret, or the clients' secret."""
    if of_cluster:
        return Caller(kind=CallerKind.CLUSTER_SECRET, roles=ALL_ROLES, name="@cluster")
    return Caller(kind=CallerKind.CLIENT_SECRET, roles=frozenset({Role.CLIENT}), name="@clients")


@dataclass(frozen=True, slots=True)
class CallerCertificate:
    """The contents of a caller's certificate.

    `serial`: its serial number, in hexadecimal digits. `ends_unix_nano`: the end of its validity; 0: unknown.
    """

    identity: Identity
    serial: str = ""
    ends_unix_nano: int = 0


def by_certificate(certified: CallerCertificate) -> Caller:
    """The caller that brings that certificate."""
    identity = certified.identity
    return Caller(
        kind=CallerKind.CERTIFICATE,
        roles=frozenset({identity.role}),
        name=identity.name,
        serial=certified.serial,
        ends_unix_nano=certified.ends_unix_nano,
    )
