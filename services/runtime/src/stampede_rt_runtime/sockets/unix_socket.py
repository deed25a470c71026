"""A Unix socket in a folder that only this user can enter."""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import stat
import tempfile
from pathlib import Path

from stampede_rt_runtime.listen import CannotListen

BACKLOG = 512
_PATH_BYTES_MAX = 107  # sun_path in unix(7)
_SUFFIX = ".sock"


def listen_at_new_path(folder: Path | None = None) -> tuple[socket.socket, Path]:
    """A listening Unix socket, and its path, which no other socket has had. Removes the paths of dead processes.

    Raises CannotListen if other users could enter the folder, or if it cannot be made.
    """
    folder = folder or _own_folder()
    path = folder / f"{secrets.token_hex(8)}{_SUFFIX}"
    if len(os.fsencode(path)) > _PATH_BYTES_MAX:
        raise CannotListen(
            f"{path} is longer than the {_PATH_BYTES_MAX} bytes of a socket's path; set a shorter $XDG_RUNTIME_DIR"
        )
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _check_own(folder)
        _remove_dead(folder)
        return _listening(path), path
    except OSError as error:
        raise CannotListen(f"no socket can be made in {folder}: {error.strerror or error}") from error


def _own_folder() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "stampede" if runtime else Path(tempfile.gettempdir()) / f"stampede-{os.geteuid()}"


def _check_own(folder: Path) -> None:
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise CannotListen(
            f"{folder} is not a folder that only this user can enter; remove it, or run: chmod 700 {folder}"
        )


def _listening(path: Path) -> socket.socket:
    """Binds another name first, so that a path with the right suffix always has a socket that listens or listened."""
    draft = path.with_suffix(".new")
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.bind(str(draft))
        made.listen(BACKLOG)
        made.setblocking(False)
        draft.rename(path)
    except BaseException:
        made.close()
        raise
    return made


def _remove_dead(folder: Path) -> None:
    for path in folder.glob(f"*{_SUFFIX}"):
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()
