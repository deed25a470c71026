"""The small file in a data folder that names the supernode and its cluster.

`init` and `join` make the file. Every start reads it. The first start and the attempts to join update it.

The log's store also names the supernode and the cluster. But this file exists before the store. It says how the
supernode makes the store at its first start.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from stampede_rt.cluster.addresses import is_loopback
from stampede_rt.errors import StampedeError
from stampede_rt_runtime.values import parse_address
from stampede_rt_runtime.written import naming
from stampede_rt_supernode.replication import Member, ReplicationSettings, holds_store

FILE_NAME = "supernode.json"
# This file exists while `init --restore` writes.
RESTORING_NAME = "supernode.restoring"
FORMAT_VERSION = 1
# The IP addresses that stand for all addresses of a machine. A server can listen at them, but no caller can call them.
ANYWHERE = ("0.0.0.0", "::")


@dataclass(frozen=True, kw_only=True)
class FoundingRecord:
    """The contents of the file: how a member starts for the first time, and which steps are done.

    `address`: the address at which the other members reach this member.

    `members`: by id, the addresses of all founders; for a member that joins, the addresses of the members at that time.
    """

    supernode_id: str
    address: str
    members: dict[str, str]
    # The id by which the members know the cluster. If `init` founded the cluster, it is also the id for all callers.
    log_cluster_id: str = ""
    # Whether the settings name all founders, and no `init` or `join` has prepared the folder. The list of founders is
    # that of --members, or this supernode alone.
    listed: bool = False
    # Whether `init --restore --take-over` founded the cluster. The cluster then also serves callers that name the
    # former cluster, whose directory was restored.
    takes_over: bool = False
    # Whether the supernode joins a running cluster instead of founding one.
    joining: bool = False
    # The join token, deleted as soon as the supernode is a member. Never shown.
    token: str = field(default="", repr=False)
    # Whether the store was opened once. From then on it must exist.
    started: bool = False
    # Why the members refused the last request to join, and how often they have refused.
    refused: str = ""
    refusals: int = 0

    def replication_settings(self, data_dir: Path | None) -> ReplicationSettings:
        """The settings of the log. Raises ValueError if fields of this record contradict each other."""
        return ReplicationSettings(
            self_member=Member(member_id=self.supernode_id, address=self.address),
            initial_members=[Member(member_id=name, address=address) for name, address in self.members.items()],
            data_dir=data_dir,
            cluster_id=self.log_cluster_id,
            joining=self.joining,
            create=not self.started,
        )


def read_founding(data_dir: Path) -> FoundingRecord | None:
    """The contents of the folder's file; None if neither `init` nor `join` has prepared it. Raises StampedeError."""
    path = data_dir / FILE_NAME
    try:
        facts: dict[str, Any] = json.loads(path.read_text())
        if facts.pop("format_version", None) != FORMAT_VERSION:
            raise StampedeError(f"{path} is of another version; run the version that wrote it")
        founding = FoundingRecord(**facts)
        founding.replication_settings(data_dir)  # also checks the contents
        return founding
    except FileNotFoundError:
        return None
    except (AttributeError, TypeError, ValueError, RecursionError) as error:
        raise StampedeError(
            f"{path} cannot be read ({error}): empty the folder, and let this member join again under a new id"
        ) from error


def write_founding(data_dir: Path, founding: FoundingRecord) -> None:
    """Write the file, whole or not at all, and readable only by the user of the process. Blocks. Raises OSError."""
    data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    text = json.dumps({"format_version": FORMAT_VERSION, **asdict(founding)}, indent=2) + "\n"
    draft = data_dir / f".{FILE_NAME}.{secrets.token_hex(4)}"
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with naming(data_dir / FILE_NAME), os.fdopen(descriptor, "w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    draft.replace(data_dir / FILE_NAME)


def note_started(data_dir: Path, founding: FoundingRecord) -> FoundingRecord:
    """Note in the file that the store exists. Returns the new contents of the file."""
    if founding.started:
        return founding
    started = replace(founding, started=True)
    write_founding(data_dir, started)
    return started


@contextlib.contextmanager
def restoring(data_dir: Path) -> Iterator[None]:
    """Keep a mark file in the folder while the caller's `with` block writes a restored store there.

    A mark that remains shows that the block failed or was interrupted. If the block fails before it has written a
    store, the mark is removed. A folder that this function has made is then removed, too.
    """
    is_new = not data_dir.exists()
    data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    mark = data_dir / RESTORING_NAME
    mark.touch(0o600)
    try:
        yield
    except BaseException:
        if not holds_store(data_dir):
            mark.unlink()
            if is_new:
                with contextlib.suppress(OSError):  # the folder has other contents
                    data_dir.rmdir()
        raise
    mark.unlink()


def check_restored(data_dir: Path) -> None:
    """Raises StampedeError if a restore into this folder was interrupted."""
    if (data_dir / RESTORING_NAME).exists():
        raise StampedeError(
            f"{data_dir} cannot be used: `stampede supernode init --restore` failed or was interrupted there; "
            "empty the folder, and run it again"
        )


def misplacement_warning(founding: FoundingRecord, listening_at: str, advertise: str) -> str:
    """The warning for a supernode that does not listen at the address at which callers reach it; empty if it does.

    With --advertise there is no warning, because the user knows that calls to that address come here.
    """
    stated, here = parse_address(founding.address), parse_address(listening_at)
    is_local = is_loopback(listening_at) and is_loopback(founding.address)
    is_at_other_host = here.host not in (*ANYWHERE, stated.host) and not is_local
    if advertise or (stated.port == here.port and not is_at_other_host):
        return ""
    return (
        f"supernode {founding.supernode_id} listens at {listening_at}, but the others call it at {founding.address}: "
        f"start it with --listen {founding.address}, or, if calls to that address come here, with --advertise "
        f"{founding.address}"
    )


def check_unused(data_dir: Path) -> None:
    """Raises StampedeError if the folder belongs to a member already."""
    check_restored(data_dir)
    if (data_dir / FILE_NAME).exists() or holds_store(data_dir):
        raise StampedeError(
            f"{data_dir} belongs to a supernode already; start that one with `stampede supernode --data-dir "
            f"{data_dir}`, or name another folder"
        )
