"""The memory of a ring: a file without a name, which readers map too."""

from __future__ import annotations

import asyncio
import fcntl
import mmap
import os
import weakref

from stampede_rt.ring.layout import RingSize
from stampede_rt.transports.mapped_pages import take_pages

SEALS = 0x1 | 0x2 | 0x4 | 0x10  # F_SEAL_SEAL, SHRINK, GROW and FUTURE_WRITE


class RingMemory:
    """Memory that no process can shrink, and that only this process can write. The system frees it after its last user.

    When no code refers to the object any more, Python frees the memory and closes the file. So both are freed even if
    the caller gives up while a worker thread makes the object.
    """

    def __init__(self, size: RingSize) -> None:
        """Take the memory. Takes some milliseconds, or more on a busy machine, so a worker thread does this.

        Raises OSError if the system gives no memory.
        """
        self.size = size
        self.file = os.memfd_create("stampede-ring", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        """The file's number. It is valid until `close`."""
        self._close_file = weakref.finalize(self, os.close, self.file)
        try:
            os.posix_fallocate(self.file, 0, size.whole_bytes)
            self.mapped = mmap.mmap(self.file, size.whole_bytes)
            fcntl.fcntl(self.file, fcntl.F_ADD_SEALS, SEALS)
        except BaseException:
            self._close_file()
            raise
        take_pages(self.mapped, to_write=True)

    def close(self) -> None:
        """Free this process' share of the memory. Release all views before. Idempotent."""
        self.mapped.close()
        self._close_file()

    def close_soon(self) -> None:
        """Close on a worker thread, because the system takes milliseconds for it. Call this on the event loop."""
        try:
            asyncio.get_running_loop().run_in_executor(None, self.close)
        except RuntimeError:  # the loop ends, and gives no thread
            self.close()
