"""The certificates of a cluster under test, made by `stampede certs` as an operator would, and certificates of
strangers.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from stampede_rt.security.tls import TlsFiles
from stampede_rt_runtime.certificates import IssuedCertificate, issue
from stampede_rt_runtime.certs_command import main as stampede_certs
from stampede_rt_runtime.certs_command import write_pair
from stampede_rt_runtime.identity import Identity, Role

CLUSTER = "robustness"
DAY = timedelta(days=1)


class Certificates:
    """An authority and its certificates, in `folder`.

    All parts of the cluster read their files there, and read them again after each change.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._authorities = 0
        self._issued: dict[tuple[Role, str], tuple[str, ...]] = {}
        folder.mkdir(mode=0o700, parents=True)
        self.add_authority()

    @property
    def ca(self) -> Path:
        """The file of the authorities that all parts trust."""
        return self.folder / "ca.pem"

    @property
    def _authority(self) -> Path:
        return self.folder / f"authority-{self._authorities}"

    def add_authority(self) -> None:
        """Make a new authority, which issues from now on. The parts still trust the former authorities."""
        self._authorities += 1
        _run("init", str(self._authority), "--cluster", CLUSTER)
        former = self.ca.read_bytes() if self.ca.exists() else b""
        self._trust(former + (self._authority / "ca.pem").read_bytes())

    def forget_former(self) -> None:
        """Let the parts trust only the newest authority from now on."""
        self._trust((self._authority / "ca.pem").read_bytes())

    def files(self, role: Role, name: str, *addresses: str) -> TlsFiles:
        """The certificate of a part. Issues it if there is none yet, for `addresses` if the part is a service."""
        if (role, name) not in self._issued:
            self._issued[role, name] = addresses
            self._issue(role, name, addresses)
        return self._files(role, name)

    def renew(self) -> None:
        """Issue every certificate again, by the newest authority."""
        for (role, name), addresses in list(self._issued.items()):
            self._issue(role, name, addresses)

    def expired(self, role: Role, name: str) -> TlsFiles:
        """A genuine certificate that ended yesterday. `stampede certs` cannot make one."""
        authority = IssuedCertificate(
            (self._authority / "ca.pem").read_bytes(), (self._authority / "ca.key").read_bytes()
        )
        identity = Identity(CLUSTER, role, name)
        made = issue(authority, identity, (), now=datetime.now(UTC) - 2 * DAY, lifetime=DAY)
        certificate, key = write_pair(made, self.folder, f"expired-{role}-{name}")
        return TlsFiles(ca=self.ca, certificate=certificate, key=key)

    def foreign(self, role: Role, name: str, folder: Path) -> TlsFiles:
        """A certificate of the same name from another authority, for a caller that trusts the cluster's authority."""
        stranger = Certificates(folder).files(role, name)
        return TlsFiles(ca=self.ca, certificate=stranger.certificate, key=stranger.key)

    def _files(self, role: Role, name: str) -> TlsFiles:
        stem = self.folder / f"{role}-{name}"
        return TlsFiles(ca=self.ca, certificate=stem.with_suffix(".pem"), key=stem.with_suffix(".key"))

    def _issue(self, role: Role, name: str, addresses: Sequence[str]) -> None:
        called_at = ["--address", *addresses] if addresses else []
        words = ["--dir", str(self._authority), "--name", name, "--role", str(role), "--out", str(self.folder)]
        _run("issue", *words, *called_at)

    def _trust(self, authorities: bytes) -> None:
        draft = self.folder / ".ca.pem"
        draft.write_bytes(authorities)
        draft.replace(self.ca)


def _run(*words: str) -> None:
    """Run `stampede certs`. Raises OSError with its output if it fails."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        code = stampede_certs(words)
    if code != 0:
        raise OSError(f"stampede certs {' '.join(words)} failed: {output.getvalue().strip()}")
