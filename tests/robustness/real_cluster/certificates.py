"""The certificates of a cluster under test, made by `stampede certs` as an operator would; and those of strangers."""

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
    """An authority and what it issued, in `folder`; all parts read their files there, and read them again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._authorities = 0
        self._issued: dict[tuple[Role, str], tuple[str, ...]] = {}
        folder.mkdir(mode=0o700, parents=True)
        self.take_over()

    @property
    def ca(self) -> Path:
        """The authorities that all parts trust."""
        return self.folder / "ca.pem"

    @property
    def _authority(self) -> Path:
        return self.folder / f"authority-{self._authorities}"

    def take_over(self) -> None:
        """A new authority issues from now on; the former ones stay trusted."""
        self._authorities += 1
        _run("init", str(self._authority), "--cluster", CLUSTER)
        former = self.ca.read_bytes() if self.ca.exists() else b""
        self._trust(former + (self._authority / "ca.pem").read_bytes())

    def forget_former(self) -> None:
        """Only the newest authority is trusted from now on."""
        self._trust((self._authority / "ca.pem").read_bytes())

    def files(self, role: Role, name: str, *addresses: str) -> TlsFiles:
        """The certificate of that part, issued if it has none yet; a service's is good for `addresses`."""
        if (role, name) not in self._issued:
            self._issued[role, name] = addresses
            self._issue(role, name, addresses)
        return self._files(role, name)

    def renew(self) -> None:
        """Issue every certificate anew, by the newest authority."""
        for (role, name), addresses in list(self._issued.items()):
            self._issue(role, name, addresses)

    def expired(self, role: Role, name: str) -> TlsFiles:
        """A genuine certificate that ended yesterday. `stampede certs` makes none, for good reasons."""
        authority = IssuedCertificate(
            (self._authority / "ca.pem").read_bytes(), (self._authority / "ca.key").read_bytes()
        )
        identity = Identity(CLUSTER, role, name)
        made = issue(authority, identity, (), now=datetime.now(UTC) - 2 * DAY, lifetime=DAY)
        certificate, key = write_pair(made, self.folder, f"expired-{role}-{name}")
        return TlsFiles(ca=self.ca, certificate=certificate, key=key)

    def foreign(self, role: Role, name: str, folder: Path) -> TlsFiles:
        """The same name from an authority that is not the cluster's, for a caller that trusts the cluster's."""
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
    """`stampede certs`. Raises OSError with what it said if it failed."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = stampede_certs(words)
    if code != 0:
        raise OSError(f"stampede certs {' '.join(words)} failed: {said.getvalue().strip()}")
