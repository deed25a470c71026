"""An ext4 file system on a loop device, which can lose its power, fail or hang like a disk. Needs root."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import struct
import subprocess
import time
from pathlib import Path

# fs/ext4/ext4.h: stop immediately, and do not even flush the journal. From then on every write and sync gives EIO.
# Unsynced data is gone after the next mount, as after a power cut, because only the kernel had it: in its page cache
# and journal.
EXT4_IOC_SHUTDOWN = 0x8004587D
NO_LOG_FLUSH = 2
IMAGE_BYTES = 64 << 20
UNMOUNT_SECONDS = 10.0


_numbers = itertools.count()


class Ext4:
    """A file system, mounted at `path` until `close`.

    Raises CalledProcessError or FileNotFoundError if it cannot be made.
    """

    def __init__(self, image: Path, path: Path) -> None:
        self._image, self.path = image, path
        self._frozen = self._mounted = False
        path.mkdir(exist_ok=True)
        image.touch()
        os.truncate(image, IMAGE_BYTES)
        _run("mkfs.ext4", "-q", str(image))
        self.mount()

    def mount(self) -> None:
        """Mount the file system. The kernel replays the journal.

        Mounts a copy of the image: a network namespace that was made meanwhile keeps the former mount alive, and a
        second mount of the same image would be the same file system, which is shut down.
        """
        copy = self._image.with_suffix(f".{next(_numbers)}")
        _run("cp", "--sparse=always", str(self._image), str(copy))
        self._image = copy
        _run("mount", "-o", "loop", str(copy), str(self.path))
        self._mounted = True

    def unmount(self) -> None:
        """Unmount the file system once no process has it open. Blocks for 10 s at most."""
        deadline = time.monotonic() + UNMOUNT_SECONDS
        while True:
            try:
                _run("umount", str(self.path))
                self._mounted = False
                return
            except subprocess.CalledProcessError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)

    def lose_power(self) -> None:
        """Cut the power: no further write reaches the disk, and unsynced data is lost."""
        folder = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.ioctl(folder, EXT4_IOC_SHUTDOWN, struct.pack("I", NO_LOG_FLUSH))
        finally:
            os.close(folder)

    def freeze(self) -> None:
        """Let every write and sync wait from now on."""
        _run("fsfreeze", "--freeze", str(self.path))
        self._frozen = True

    def thaw(self) -> None:
        """Let the waiting writes and syncs go on."""
        if self._frozen:
            _run("fsfreeze", "--unfreeze", str(self.path))
            self._frozen = False

    def close(self) -> None:
        """Unmount the file system and free the loop device, in any state. Idempotent.

        A process that still has a file open does not keep the mount. The loop device goes with the last such process.
        """
        with contextlib.suppress(subprocess.CalledProcessError):
            self.thaw()
        if self._mounted:
            _run("umount", "--lazy", str(self.path))
            self._mounted = False


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True)
