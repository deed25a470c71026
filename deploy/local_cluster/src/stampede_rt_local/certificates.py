"""The certificates of a cluster on this machine: an authority in a folder, and a certificate for each part."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from stampede_rt.security.tls import TlsFiles
from stampede_rt_runtime.certificates import IssuedCertificate, issue, make_authority
from stampede_rt_runtime.certs_command import write_pair
from stampede_rt_runtime.identity import Identity, Role

CLUSTER = "local"
LIFETIME = timedelta(days=30)
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


class ClusterCertificates:
    """Makes an authority and `folder`, which only this user can read.

    `host`: the name at which callers reach services.
    """

    def __init__(self, folder: Path, *, host: str = "localhost", cluster: str = CLUSTER) -> None:
        self.folder = folder
        self._cluster = cluster
        self._addresses = tuple(dict.fromkeys((host, *_LOOPBACK)))
        self._issued: dict[tuple[Role, str], TlsFiles] = {}
        folder.mkdir(mode=0o700, parents=True)
        self._trusted: list[bytes] = []
        self._authority = self.add_authority()

    @property
    def ca(self) -> Path:
        """The file with the authorities that all parts trust."""
        return self.folder / "ca.pem"

    def add_authority(self) -> IssuedCertificate:
        """Use a new authority from now on. All parts still trust the former ones."""
        self._authority = make_authority(self._cluster, now=datetime.now(UTC), lifetime=LIFETIME)
        self._trust([*self._trusted, self._authority.certificate])
        return self._authority

    def forget_former(self) -> None:
        """Let all parts trust only the newest authority from now on."""
        self._trust([self._authority.certificate])

    def _trust(self, authorities: list[bytes]) -> None:
        self._trusted = authorities
        draft = self.folder / ".ca.pem"
        draft.write_bytes(b"".join(authorities))
        draft.replace(self.ca)

    def issue(
        self, role: Role, name: str, *, begins: datetime | None = None, lifetime: timedelta = LIFETIME
    ) -> TlsFiles:
        """Issue a certificate for that part, which replaces its former one. `begins`: now by default."""
        identity = Identity(self._cluster, role, name)
        now = begins or datetime.now(UTC)
        made = issue(self._authority, identity, self._addresses, now=now, lifetime=lifetime)
        certificate, key = write_pair(made, self.folder, identity.file_stem)
        self._issued[role, name] = TlsFiles(ca=self.ca, certificate=certificate, key=key)
        return self._issued[role, name]

    def renew(self) -> None:
        """Issue every certificate anew."""
        for role, name in list(self._issued):
            self.issue(role, name)
