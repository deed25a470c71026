"""Credentials of a caller: the shared secret, its file and its metadata, and certificates."""

from __future__ import annotations

import logging
import os
import stat
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from stampede_rt.errors import PermissionDenied
from stampede_rt.security.tls import LOOK_EVERY_S, TlsMaterial, TlsReader

logger = logging.getLogger(__name__)


def secret_file() -> Path:
    """Return the path of the secret: the path in `$STAMPEDE_SECRET_FILE`, or the path of the user's own secret file.

    The user's own file is `stampede/secret` below `$XDG_CONFIG_HOME`, or below `~/.config`.
    """
    named = os.environ.get("STAMPEDE_SECRET_FILE")
    if named:
        return Path(named)
    return user_folder(os.environ) / "secret"


def user_folder(environ: Mapping[str, str]) -> Path:
    """Return the folder with the secret and the saved contexts of this user. It may not exist.

    For a user without a home folder, as in some containers, the home folder is `/`, as at a login.
    """
    if base := environ.get("XDG_CONFIG_HOME"):
        return Path(base) / "stampede"
    try:
        home = Path.home()
    except RuntimeError:
        home = Path("/")
    return home / ".config" / "stampede"


SECRETS_MAX = 2


def read_secret(path: Path | None = None) -> str | None:
    """Return the secret that a caller sends: the first line of the file `path` (default: `secret_file()`).

    None if there is no such file; "" if the file is empty. Raises PermissionDenied if the file cannot be used, or if
    every user of the machine may read it.
    """
    values = read_secrets(path)
    return None if values is None else "".join(values[:1])


def read_secrets(path: Path | None = None) -> tuple[str, ...] | None:
    """Return all secrets in the file `path`, one on each line; None if there is no such file. Services accept each one.

    A file has at most two secrets, so that an operator can replace the secret of a running cluster. Raises
    PermissionDenied if the file cannot be used, or if every user of the machine may read it.
    """
    path = path or secret_file()
    try:
        mode = path.stat().st_mode
        text = path.read_text().strip()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise PermissionDenied(
            f"the secret file {path} cannot be read: {error.strerror}; give this user the right to read it"
        ) from error
    except UnicodeDecodeError as error:
        raise _no_secret(path) from error
    if stat.S_IMODE(mode) & 0o007:
        raise PermissionDenied(f"the secret file {path} can be read by every user; run: chmod 600 {path}")
    values = tuple(line.strip() for line in text.splitlines() if line.strip())
    if not all(value.isascii() and value.isprintable() for value in values):
        raise _no_secret(path)
    if len(values) > SECRETS_MAX:
        raise PermissionDenied(
            f"the secret file {path} has {len(values)} lines; write one secret, or two while you replace a secret"
        )
    return values


class SecretReader:
    """Gives the present secret or token in a file. Several threads may use it.

    The constructor reads the file, as `read_secret` does. If the file changes later and cannot be used, the reader logs
    a warning and keeps the last good secret.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._stamp = _stamp(path)  # before the reading: so a change during the reading has another stamp
        self._secret = read_secret(path)
        self._looked_s = time.monotonic()

    def current(self) -> str | None:
        """Return the last good secret; None if there was no file. Looks for a change at most once in LOOK_EVERY_S."""
        with self._lock:
            if time.monotonic() - self._looked_s >= LOOK_EVERY_S:
                self._looked_s = time.monotonic()
                self._look()
            return self._secret

    def _look(self) -> None:
        stamp = _stamp(self.path)
        if stamp in (self._stamp, None):
            return
        try:
            self._secret = read_secret(self.path) or self._secret
        except PermissionDenied as error:
            logger.warning(
                "the secret file has changed, but cannot be used; the earlier secret counts: %s",
                error,
                extra={"event": "secret_file_unusable"},
            )
        self._stamp = stamp


def _stamp(path: Path) -> tuple[int, int, int] | None:
    """Values that differ after each change of the file; None: there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def _no_secret(path: Path) -> PermissionDenied:
    """Return the error for a secret with forbidden characters. A header carries it, so it must be printable ASCII."""
    return PermissionDenied(
        f"the secret file {path} holds other characters than printable ASCII; copy the file of the cluster again"
    )


def call_metadata(secret: str | None) -> tuple[tuple[str, str], ...]:
    """Return the metadata with which a call carries the secret; empty without a secret."""
    return (("authorization", f"Bearer {secret}"),) if secret else ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Credentials:
    """The secret or token of a caller, or the reader of its file, and its certificates. Each may be missing."""

    secret: str | SecretReader | None = field(default=None, repr=False)
    tls: TlsReader | None = None

    def present_secret(self) -> str | None:
        """Return the secret for a new call."""
        return self.secret.current() if isinstance(self.secret, SecretReader) else self.secret

    def material(self) -> TlsMaterial | None:
        """Return the present certificates for a new connection; None if the connection is plain text."""
        return self.tls.current() if self.tls else None
