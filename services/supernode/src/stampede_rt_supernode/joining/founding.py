"""Which member of which cluster a data folder is for: a small file, written by `init` and `join`, read at every start.

The log's store knows its own identity too; this file is there before the store, and says how to begin.
"""

from __future__ import annotations

import json
import os
import secrets
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from stampede_rt.errors import StampedeError
from stampede_rt_runtime.written import naming
from stampede_rt_supernode.replication import Member, ReplicationSettings, holds_store

FILE_NAME = "supernode.json"
FORMAT_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Founding:
    """How a member came to be. `members` are all founders, or, for one that joins, those it was told of."""

    supernode_id: str
    address: str
    members: dict[str, str]
    # What the members call the cluster among each other; founded by `init`, it is the cluster's own id.
    log_cluster_id: str = ""
    # Whether it is founded by a list of members, which they all were given.
    listed: bool = False
    # Whether the hosts of the cluster that is restored may go over to this one.
    takes_over: bool = False
    joining: bool = False
    # Lets it in; forgotten once it is a member. Not shown.
    token: str = field(default="", repr=False)
    # Whether the store was opened once: from then on it must be there.
    started: bool = False

    def replication_settings(self, data_dir: Path | None) -> ReplicationSettings:
        """What the log is to be told."""
        return ReplicationSettings(
            self_member=Member(member_id=self.supernode_id, address=self.address),
            initial_members=[Member(member_id=name, address=address) for name, address in self.members.items()],
            data_dir=data_dir,
            cluster_id=self.log_cluster_id,
            joining=self.joining,
            create=not self.started,
        )


def read_founding(data_dir: Path) -> Founding | None:
    """What the folder is for, None if neither `init` nor `join` has prepared it. Raises StampedeError."""
    place = data_dir / FILE_NAME
    try:
        facts: dict[str, Any] = json.loads(place.read_text())
        if facts.pop("format_version", None) != FORMAT_VERSION:
            raise StampedeError(f"{place} is of another version; run the version that wrote it")
        return Founding(**facts)
    except FileNotFoundError:
        return None
    except (AttributeError, TypeError, ValueError) as error:
        raise StampedeError(
            f"{place} cannot be read ({error}): empty the folder, and let this member join again under a new id"
        ) from error


def write_founding(data_dir: Path, founding: Founding) -> None:
    """Write the file, whole or not at all, and readable by its user only. Blocks. Raises OSError."""
    data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    text = json.dumps({"format_version": FORMAT_VERSION, **asdict(founding)}, indent=2) + "\n"
    draft = data_dir / f".{FILE_NAME}.{secrets.token_hex(4)}"
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with naming(data_dir / FILE_NAME), os.fdopen(descriptor, "w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    draft.replace(data_dir / FILE_NAME)


def note_started(data_dir: Path, founding: Founding) -> Founding:
    """Note that the store is there."""
    if founding.started:
        return founding
    started = replace(founding, started=True)
    write_founding(data_dir, started)
    return started


def check_unused(data_dir: Path) -> None:
    """Raises StampedeError if the folder is some member's already."""
    if (data_dir / FILE_NAME).exists() or holds_store(data_dir):
        raise StampedeError(
            f"{data_dir} is a supernode's already; start that one with `stampede supernode --data-dir {data_dir}`, "
            "or name another folder"
        )
