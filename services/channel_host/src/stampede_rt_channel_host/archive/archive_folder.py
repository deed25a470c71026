"""The archive folder of one host: its owner, and the lock that keeps other processes out."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from stampede_rt.escaping import escaped
from stampede_rt_channel_host.archive.disk_use import FoundFolder, folders_of_channels
from stampede_rt_channel_host.archive.stable_writes import make_folder, sync_folder
from stampede_rt_runtime.settings import SettingsError

PLACE_CHARACTERS_MAX = 1024
_LOCK_FILE, _OWNER_FILE, _CHANNELS, _STOPPED_FILE = "lock", "owner", "channels", "stopped"


class ArchiveFolder:
    """Belongs to one host, by its host id, and to one process at a time.

    `open` makes the folder if it is missing. Raises SettingsError, which says what to do: the folder belongs to another
    host, another process uses it, or it cannot be written.
    """

    def __init__(self, path: Path, bytes_max: int = 0) -> None:
        """`bytes_max`: the most bytes that the archive may have.

        0: nine tenths of the sum of its own bytes and the free bytes of its disk.
        """
        self.path = path
        self._bytes_max = bytes_max
        self._lock: IO[str] | None = None

    def open(self, host_id: bytes) -> None:
        """Take the folder for this process and host."""
        try:
            make_folder(self.path)
            make_folder(self.path / _CHANNELS)
            self._lock = (self.path / _LOCK_FILE).open("a")
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self.close()
            raise SettingsError(
                f"--archive: another host uses the folder {self.path} now; stop that host, or give this one its own "
                "folder"
            ) from error
        try:
            self._check_owner(host_id.hex())
        except OSError as error:
            self.close()
            raise self._unwritable(error) from error
        except SettingsError:
            self.close()
            raise

    def _unwritable(self, error: OSError) -> SettingsError:
        return SettingsError(
            f"--archive: the folder {self.path} cannot be written ({error.strerror}); give one that this user can write"
        )

    def _check_owner(self, host_id: str) -> None:
        path = self.path / _OWNER_FILE
        owner = path.read_text(errors="replace").strip() if path.exists() else ""
        if not owner:
            _write(path, host_id)
        elif owner != host_id:
            raise SettingsError(
                f"--archive: the folder {self.path} is the archive of host {owner}, and this is host {host_id}; give "
                f"this host a folder of its own. To open this folder as host {owner}, run `stampede host` with the "
                "--data-dir whose file host-id has that id. If the file host-id is in the folder itself, leave "
                "--data-dir out"
            )

    def boot_of_last_stop(self) -> int:
        """The boot incarnation of the last process that had archived all items before it stopped; 0: none is known.

        Only the directory knows whether another process of the host has registered since. Raises OSError.
        """
        path = self.path / _STOPPED_FILE
        text = path.read_text(errors="replace").strip() if path.exists() else ""
        return int(text) if text.isdecimal() and int(text) < 2**64 else 0

    def note_stop(self, boot_incarnation: int) -> None:
        """Note that this process has archived all items of all recorded channels, and stops. Raises OSError."""
        _write(self.path / _STOPPED_FILE, str(boot_incarnation))

    def place_text(self, url: str | None) -> str:
        """The folder as a text for people. `url`: the URL of the object store that has the archive, too, or None.

        At most PLACE_CHARACTERS_MAX printable characters.
        """
        folder = os.path.abspath(self.path)
        return escaped(folder if url is None else f"{url} and {folder}")[:PLACE_CHARACTERS_MAX]

    @property
    def channels(self) -> Path:
        """The folder with a folder for each channel."""
        return self.path / _CHANNELS

    def of_channel(self, channel_id: bytes) -> Path:
        """The folder of one channel's segments."""
        return self.channels / channel_id.hex()

    def of_channels(self) -> Iterator[FoundFolder]:
        """The folders of all channels, including deleted channels. Blocks its thread. Raises OSError."""
        return folders_of_channels(self.path / _CHANNELS)

    def limit_bytes(self, used_bytes: int, reserved_bytes: int = 0) -> int:
        """The most bytes that the archive may have, if it has `used_bytes` now. Raises OSError.

        `reserved_bytes`: the free bytes of the disk that the archive leaves to other users.
        """
        return self._bytes_max or max(0, used_bytes + shutil.disk_usage(self.path).free - reserved_bytes) * 9 // 10

    def close(self) -> None:
        """Let other processes use the folder."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def close_copy(self) -> None:
        """In a forked child, close the copy of the lock. The folder still belongs to the parent.

        The descriptor then refers to /dev/null, because the object that owns the descriptor may close it later.
        """
        lock = self._lock
        if lock is not None and not lock.closed:
            with open(os.devnull, "rb") as nothing:
                os.dup2(nothing.fileno(), lock.fileno(), inheritable=False)


def _write(path: Path, text: str) -> None:
    """Write a file atomically. Raises OSError."""
    draft = path.with_suffix(".draft")
    with draft.open("w") as file:
        file.write(text + "\n")
        file.flush()
        os.fsync(file.fileno())
    draft.rename(path)
    sync_folder(path.parent)
