"""The number of commits of a store, in a file beside the database.

SQLite treats a damaged frame of its write-ahead log as the end of the log, and reports no error: committed entries are
lost without notice. So the store counts its commits, and writes their number to the database and to this file. If the
number in the database is lower than the number in the file, the database is damaged.

The store syncs the file about once a second, and not at every commit. After a power failure the number in the file may
therefore be too low by the commits of about a second. If the database has lost no more than these commits, the store
does not notice the loss. While this file is intact, the store detects every
greater loss.
"""

from __future__ import annotations

import os
import struct
import time
import zlib
from pathlib import Path

# The shortest time between two syncs of the file.
FORCE_SECONDS = 1.0
# The number of commits, and a checksum of it.
_RECORD = struct.Struct("<QI")


class Watermark:
    """The file with the number of commits of a database. Only one object may write the file."""

    def __init__(self, path: Path) -> None:
        """Open or create the file. Raises OSError."""
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self._forced_at = float("-inf")

    def read(self) -> int:
        """The number noted last; 0 if there is none, or if the file is damaged.

        Damage to the file does not mean that the database is damaged.
        """
        record = os.pread(self._file, _RECORD.size, 0)
        if len(record) != _RECORD.size:
            return 0
        commits, checksum = _RECORD.unpack(record)
        return int(commits) if checksum == zlib.crc32(b"%d" % commits) else 0

    def note(self, commits: int) -> None:
        """Write the number of commits in the database to the file. Syncs the file, and blocks, about once a second."""
        os.pwrite(self._file, _RECORD.pack(commits, zlib.crc32(b"%d" % commits)), 0)
        if time.monotonic() - self._forced_at >= FORCE_SECONDS:
            os.fdatasync(self._file)
            self._forced_at = time.monotonic()

    def close(self) -> None:
        """Sync and close the file."""
        os.fdatasync(self._file)
        os.close(self._file)
