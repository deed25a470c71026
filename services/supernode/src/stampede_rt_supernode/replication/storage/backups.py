"""A backup: one snapshot as a file with its origin and a checksum.

The file has `MAGIC`, a line of JSON (BackupHeader), the snapshot's record, and the SHA-256 of all of these. So a
restore recognises a file that was cut off, or in which a bit has changed, and refuses it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from stampede_rt_supernode.replication.storage.store import StoreDamaged, StoredSnapshot, StoredState
from stampede_rt_supernode.replication.wire.records import MalformedMessage, SnapshotContents, decode_snapshot

# The first line of every backup.
MAGIC = b"stampede-rt directory backup 1\n"
# The size of the parts in which a backup is sent.
PART_BYTES = 1 << 20
SHA256_BYTES = 32


@dataclass(frozen=True, kw_only=True, slots=True)
class BackupHeader:
    """The origin of a backup: the member that made it, the time, and the last log position that it covers."""

    member_id: str
    cluster_id: str
    log_index: int
    time_unix_nano: int


@dataclass(frozen=True, slots=True)
class Backup:
    """The bytes of a backup, ready to be sent. `head` is all that comes before the snapshot's record."""

    head: bytes
    record: bytes
    sha256: bytes

    @property
    def size_bytes(self) -> int:
        """The bytes of the whole file."""
        return len(self.head) + len(self.record) + SHA256_BYTES

    def parts(self) -> Iterator[bytes]:
        """The bytes of the file, in order, in several parts."""
        yield self.head
        for start in range(0, len(self.record), PART_BYTES):
            yield self.record[start : start + PART_BYTES]
        yield self.sha256


def make_backup(header: BackupHeader, record: bytes) -> Backup:
    """The backup that holds the snapshot `record`. Takes a while for a large record."""
    head = MAGIC + json.dumps(asdict(header)).encode() + b"\n"
    digest = hashlib.sha256(head)
    digest.update(record)
    return Backup(head, record, digest.digest())


def read_backup(path: Path) -> tuple[BackupHeader, StoredState]:
    """Read a backup. Returns its origin, and the state of a member that has only the backup's snapshot. Blocks.

    Raises StoreDamaged if the file is not a backup, is cut off or damaged, or is of another version. Raises OSError.
    """
    data = path.read_bytes()
    if not data.startswith(MAGIC):
        raise StoreDamaged(f"{path} is not a backup of a directory; name a file of `stampede supernode snapshot`")
    body, sha256 = data[:-SHA256_BYTES], data[-SHA256_BYTES:]
    if hashlib.sha256(body).digest() != sha256:
        raise StoreDamaged(f"{path} fails its checksum: it is cut off or damaged; use another backup")
    line, _, record = body[len(MAGIC) :].partition(b"\n")
    try:
        header, snapshot = BackupHeader(**json.loads(line)), decode_snapshot(record)
    except (TypeError, ValueError, RecursionError, MalformedMessage) as error:
        raise StoreDamaged(f"{path} cannot be read by this version ({error}): use the one that wrote it") from error
    return header, _state(snapshot, record)


def _state(snapshot: SnapshotContents, record: bytes) -> StoredState:
    last = snapshot.last
    return StoredState(
        entries=[snapshot.previous, last],
        term=last.term,
        commit_index=last.log_index,
        snapshot=StoredSnapshot.of(last.log_index, record),
    )
