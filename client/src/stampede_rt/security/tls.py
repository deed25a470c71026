"""Reads and checks the certificate files of a caller or service with mutual TLS, also when the files change."""

from __future__ import annotations

import logging
import os
import ssl
import stat
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from stampede_rt.errors import InvalidArgument, PermissionDenied

logger = logging.getLogger(__name__)

LOOK_EVERY_S = 1.0  # a connection that begins this long after a change of the files uses the new contents
_PARTS = ("ca", "certificate", "key")
CLIENT_VARIABLES = tuple(f"STAMPEDE_TLS_{part.upper()}" for part in _PARTS)
"""The names of a client's environment variables. Services have other names, so that one shell can hold both."""
_READ_TRIES_MAX = 3  # tries, if the files change during the reading
_PATIENT_TRIES_MAX = 5  # tries at the start of the program, if the files do not work
_PATIENCE_S = 0.05  # the pause between two of the tries at the start

_Stamp = tuple[tuple[int, int, int], ...]  # for each file its inode, size and time of change


@dataclass(frozen=True, kw_only=True, slots=True)
class TlsFiles:
    """The files of a caller's certificate, in PEM form.

    - `ca`: one or more trusted authorities.
    - `certificate`: the caller's certificate, with the chain to an authority.
    - `key`: the private key of that certificate, not encrypted. The file must not be readable by every user.
    """

    ca: str | os.PathLike[str]
    certificate: str | os.PathLike[str]
    key: str | os.PathLike[str]

    def paths(self) -> tuple[Path, Path, Path]:
        """The paths of `ca`, `certificate` and `key`, in this order."""
        return Path(self.ca), Path(self.certificate), Path(self.key)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TlsMaterial:
    """The contents of the files at one reading. Each reading makes a new object, which is equal only to itself."""

    ca: bytes
    certificate: bytes
    key: bytes

    def __repr__(self) -> str:
        return "TlsMaterial(...)"  # does not show the key


def files_from_environment(
    environ: Mapping[str, str], variables: tuple[str, ...] = CLIENT_VARIABLES
) -> TlsFiles | None:
    """Return the files that the environment variables `variables` name; None if no variable is set.

    `variables` has the names for ca, certificate and key, in this order. Raises InvalidArgument if only some are set.
    """
    named = {part: environ[variable] for part, variable in zip(_PARTS, variables, strict=True) if environ.get(variable)}
    missing = [f"${variable}" for variable in variables if not environ.get(variable)]
    if named and missing:
        every = ", ".join(f"${variable}" for variable in variables)
        raise InvalidArgument(f"{' and '.join(missing)} must be set, too: TLS needs all of {every}")
    return TlsFiles(**named) if named else None


class TlsReader:
    """Gives the present contents of the files. Several threads may use it.

    The constructor reads the files, and raises PermissionDenied if they cannot be used together. If the files change
    later and cannot be used (a half-written file, the key of another certificate), the reader logs a warning and keeps
    the last good contents.
    """

    def __init__(self, files: TlsFiles) -> None:
        self.files = files
        self._lock = threading.Lock()
        self._stamp, self._material = _read_patiently(files)
        self._refused: _Stamp | None = None  # the stamp of changed files that cannot be used
        self._looked_s = time.monotonic()  # when the reader last looked for changes

    def current(self) -> TlsMaterial:
        """Return the last good contents. Looks for changes of the files at most once in LOOK_EVERY_S."""
        with self._lock:
            if time.monotonic() - self._looked_s >= LOOK_EVERY_S:
                self._looked_s = time.monotonic()
                self._look()
            return self._material

    def _look(self) -> None:
        stamp = _stamp_if_there(self.files)  # before the reading: so a change during the reading has another stamp
        if stamp is not None and stamp in (self._stamp, self._refused):
            return
        try:
            self._stamp, self._material = _read(self.files)
            logger.info(
                "new certificates from now on: %s", self.files.certificate, extra={"event": "certificate_renewed"}
            )
        except (PermissionDenied, OSError) as error:
            logger.warning(
                "the certificate files have changed, but cannot be used; the earlier contents stay in use: %s",
                error,
                extra={"event": "certificate_files_unusable"},
            )
            self._refused = stamp


def _stamp(files: TlsFiles) -> _Stamp:
    found = (os.stat(path) for path in files.paths())
    return tuple((one.st_ino, one.st_size, one.st_mtime_ns) for one in found)


def _stamp_if_there(files: TlsFiles) -> _Stamp | None:
    try:
        return _stamp(files)
    except OSError:
        return None


def _read(files: TlsFiles) -> tuple[_Stamp, TlsMaterial]:
    """Return the stamp and the checked contents of the files, all as of one moment. Raises PermissionDenied."""
    for _ in range(_READ_TRIES_MAX):
        before = _stamp_if_there(files)
        ca, certificate, key = (_bytes_of(path) for path in files.paths())
        check_files(files)
        if before is not None and _stamp_if_there(files) == before:
            return before, TlsMaterial(ca=ca, certificate=certificate, key=key)
    raise PermissionDenied(f"the certificate {files.certificate} changes while it is read; try again")


def _read_patiently(files: TlsFiles) -> tuple[_Stamp, TlsMaterial]:
    """Like `_read`, but try again after a short wait if it fails, because an operator may be replacing the files."""
    for _ in range(_PATIENT_TRIES_MAX - 1):
        try:
            return _read(files)
        except PermissionDenied:
            time.sleep(_PATIENCE_S)
    return _read(files)


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise PermissionDenied(f"{path} cannot be read: {error.strerror}; it must be a file in PEM form") from error


def check_files(files: TlsFiles) -> None:
    """Raise PermissionDenied if the files hold no certificates or do not belong together.

    Raise PermissionDenied also if every user may read the key.
    """
    ca, certificate, key = files.paths()
    if stat.S_IMODE(key.stat().st_mode) & 0o007:
        raise PermissionDenied(f"the private key {key} can be read by every user; run: chmod 600 {key}")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(cafile=ca)
    except ssl.SSLError as error:
        raise PermissionDenied(f"{ca} holds no certificate of an authority ({error.reason or error})") from error
    try:
        # Without a password here, OpenSSL would ask for one at the terminal.
        context.load_cert_chain(certificate, key, password=lambda: "-")
    except ssl.SSLError as error:
        what = f"the certificate {certificate} and the private key {key} cannot be used together"
        raise PermissionDenied(f"{what} ({error.reason or error}); issue both again") from error
