"""The identity of this host: an id kept in its data folder, a name, and a number for each start of the process."""

from __future__ import annotations

import fcntl
import os
import secrets
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from stampede_rt.cluster.cluster_ids import may_change_to, wrong_cluster
from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt_runtime.written import naming

ID_BYTES = 16
_FILE = "host-id"
_CLUSTER_FILE = "cluster-id"
_NEW_HOST = "remove it, and the host registers as a new one"


@dataclass(frozen=True, kw_only=True, slots=True)
class HostIdentity:
    """The identity of the host, as the host sends it to the directory.

    `boot_incarnation` is new at each start of the process, because a start loses the host's earlier items.
    `has_archive`: the host can record channels. `continues`: the boot incarnation of the former process that left all
    items of its recorded channels in that archive, or 0. `move_key`: the secret key of its permits for moves, new at
    each start, too; empty: it gives none. `is_private`: the directory places nothing here unless a caller names this
    host. `archive_wait_nanos`: how long the recorded channels of the host wait for it when it is unreachable.
    `archive_place`: where its archive is, for people.
    """

    host_id: bytes
    name: str
    boot_incarnation: int
    zone: str = ""
    has_archive: bool = False
    continues: int = 0
    move_key: bytes = field(default=b"", repr=False)
    is_private: bool = False
    archive_wait_nanos: int = 0
    archive_place: str = ""


def load_host_id(folder: Path | None) -> bytes:
    """The host's id from its file in `folder`. Makes the file if it is missing. `folder` None: returns a new id.

    Raises InvalidArgument if the file holds no id, OSError if the folder cannot be read or written.
    """
    if folder is None:
        return secrets.token_bytes(ID_BYTES)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    path = folder / _FILE
    with _alone(folder):  # two hosts that start together must not make two ids
        if not path.exists():
            _write_atomically(path, secrets.token_hex(ID_BYTES))
    return _read(path)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Let one process at a time into the block. Some network file systems cannot lock a folder, and let all in."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


class HomeCluster:
    """The cluster with which this host has registered. Keeps the cluster's id in a file in `folder`; None: in no file.

    `cluster_id` is empty before the first registration. Raises InvalidArgument if the file holds no text.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._path = None if folder is None else folder / _CLUSTER_FILE
        remedy = "remove it, and the host may register with any cluster"
        self.cluster_id = _kept_text(self._path, "cluster id", remedy) if self._path and self._path.exists() else ""
        self._noted = ""  # the id with which `note` was called last
        self._former: tuple[str, ...] = ()  # the clusters that the present one has replaced

    def judge(self, caller_cluster_id: str) -> StampedeError | None:
        """The error for a caller that names this id as its cluster; None if the host serves such callers."""
        if may_change_to(caller_cluster_id, self.cluster_id, self._former):
            return None
        return wrong_cluster("this host", self.cluster_id, caller_cluster_id)

    def is_noted(self, cluster_id: str) -> bool:
        """Whether the last `note` in this process had this id. Always True for an empty id, which needs no note."""
        return cluster_id in ("", self._noted)

    def note(self, cluster_id: str, former: Iterable[str] = ()) -> None:
        """Note the cluster that has let this host in. `former`: the clusters that this cluster has replaced.

        Raises OSError if the file cannot be written.
        """
        self._former = tuple(former)
        self._noted = cluster_id
        if cluster_id in ("", self.cluster_id):
            return
        if self._path is not None:
            _write_atomically(self._path, cluster_id)
        self.cluster_id = cluster_id


def _write_atomically(path: Path, text: str) -> None:
    """Write a file whole or not at all, so that a crash leaves no partial id."""
    draft = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    with naming(path), draft.open("w") as file:
        file.write(text + "\n")
        file.flush()
        os.fsync(file.fileno())
    draft.rename(path)


def _kept_text(path: Path, what: str, remedy: str) -> str:
    """The text of the file. Raises InvalidArgument if the file is not UTF-8. `what` and `remedy` go into that error."""
    try:
        return path.read_text().strip()
    except UnicodeDecodeError as error:
        raise InvalidArgument(f"{path} holds no {what}; {remedy}") from error


def _read(path: Path) -> bytes:
    try:
        host_id = bytes.fromhex(_kept_text(path, "host id", _NEW_HOST))
    except ValueError:
        host_id = b""
    if len(host_id) != ID_BYTES:
        raise InvalidArgument(f"{path} holds no host id; {_NEW_HOST}")
    return host_id


def default_name() -> str:
    """The machine's name in letters that the directory allows, and six random hexadecimal digits.

    The digits are there because a machine may run many hosts.
    """
    allowed = "abcdefghijklmnopqrstuvwxyz0123456789._-"
    machine = "".join(letter if letter in allowed else "-" for letter in socket.gethostname().lower())
    return f"{machine.lstrip('._-')[:100] or 'host'}-{secrets.token_hex(3)}"


def new_boot_incarnation() -> int:
    """A random number from 1 to 2**64 - 1."""
    return secrets.randbits(64) | 1
