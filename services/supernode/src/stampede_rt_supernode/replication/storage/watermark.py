"""How many commits a store has seen, in a file beside the database.

SQLite takes a damaged frame of its write-ahead log for the end of the log, and says that all is well with what
is left: committed entries are gone without a word. So every commit also counts, in the database and here, and a
database that has seen fewer commits than this file is damaged.

The file is forced to the disk about once a second, not with every commit: it is a lower bound, and after a
power failure an older one still finds every loss that reaches further back.
"""

from __future__ import annotations

import os
import struct
import time
import zlib
from pathlib import Path

FORCE_SECONDS = 1.0
_RECORD = struct.Struct("<QI")


class Watermark:
    """The count beside a database. One writer."""

    def __init__(self, path: Path) -> None:
        """Open or create; raises OSError."""
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self._forced_at = float("-inf")

    def read(self) -> int:
        """The highest count noted; 0 when there is none or the file itself is damaged: it accuses nobody then."""
        record = os.pread(self._file, _RECORD.size, 0)
        if len(record) != _RECORD.size:
            return 0
        commits, checksum = _RECORD.unpack(record)
        return int(commits) if checksum == zlib.crc32(b"%d" % commits) else 0

    def note(self, commits: int) -> None:
        """Note a count that the database holds; blocks on the disk about once a second."""
        os.pwrite(self._file, _RECORD.pack(commits, zlib.crc32(b"%d" % commits)), 0)
        if time.monotonic() - self._forced_at >= FORCE_SECONDS:
            os.fdatasync(self._file)
            self._forced_at = time.monotonic()

    def close(self) -> None:
        """Force the count to the disk and let go."""
        os.fdatasync(self._file)
        os.close(self._file)
