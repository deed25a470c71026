"""Empties the folders of channels that this host does not record now: moves or deletes their closed files."""

from __future__ import annotations

import shutil
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Protocol

from stampede_rt_channel_host.archive.clean_stop import name_of_stop, read_stop, stop_named, write_stop
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.segment_store import SegmentStore
from stampede_rt_channel_host.archive.objects.stored_segments import OBJECTS
from stampede_rt_channel_host.archive.segment_folder import SegmentFolder
from stampede_rt_channel_host.archive.stable_writes import sync_folder
from stampede_rt_channel_host.core.archive.stored_segment import segment_named

FOLDERS_PER_STEP = 8
OBJECTS_PER_DELETION = 100
EPOCH_MAX = 2**63
_DELETED_FILE = "deleted"


class ThreadCall(Protocol):
    """A function that performs a call in a thread."""

    def __call__(self, call: Callable[[], list[str]]) -> Awaitable[list[str]]:
        """Return the result of the call."""
        ...


class Leftovers:
    """The channels whose folders were in `folder` when the host started, and the channels that were deleted since.

    The folder of a channel that stopped cleanly keeps the note of this stop. `open_files` makes the `MovingFiles` of
    the channel with the given id.
    """

    def __init__(self, folder: Path, store: SegmentStore, open_files: Callable[[bytes], MovingFiles]) -> None:
        self._folder, self._store, self._open_files = folder, store, open_files
        self._taken: set[bytes] = set()
        self._owned: dict[bytes, int] = {}  # the epochs, by channel id
        self._condemned: list[bytes] = []
        self._found: list[bytes] = []

    def own(self, epochs: Mapping[bytes, int]) -> None:
        """Note the channels that the host owns now, by their ids, with their epochs."""
        self._owned = dict(epochs)

    def stops(self) -> dict[str, Callable[[], None]]:
        """The names of objects that the host must make. The caller makes an object, and then calls its function.

        An object reports the clean stop of a channel that this host owns, and has not served since its start. The host
        accepted no items of the channel in the present epoch. So the note of its former stop is still true, if this
        note names the epoch before the present one. Blocks its thread. Raises OSError.
        """
        found: dict[str, Callable[[], None]] = {}
        for channel_id, epoch in self._owned.items():
            path = self._folder / channel_id.hex()
            if self.is_taken(channel_id) or channel_id in self._condemned or not path.is_dir():
                continue
            stop = read_stop(path)
            if stop is not None and stop.epoch == epoch - 1 and not SegmentFolder(path).numbers():
                present = stop._replace(epoch=epoch)
                found[f"{OBJECTS}/{path.name}/{name_of_stop(present)}"] = partial(write_stop, path, present)
        return found

    def take(self, channel_id: bytes) -> None:
        """Note that the host serves the channel from now on."""
        self._taken.add(channel_id)

    def give_back(self, channel_id: bytes) -> None:
        """Note that the host does not serve the channel after all."""
        self._taken.discard(channel_id)
        if channel_id not in (*self._found, *self._condemned):
            self._found.append(channel_id)

    def is_taken(self, channel_id: bytes) -> bool:
        """Whether the host has served the channel since it started."""
        return channel_id in self._taken

    def look(self) -> None:
        """Find the folders of channels in `folder`. Blocks its thread. Raises OSError."""
        for path in self._folder.iterdir() if self._folder.is_dir() else ():
            channel_id = _channel_of(path)
            if channel_id is None:
                continue
            if (path / _DELETED_FILE).exists():
                self._condemned.append(channel_id)
            else:
                self._found.append(channel_id)

    def open_next(self) -> list[MovingFiles]:
        """Open some of the folders, for their closed files to be moved. Blocks its thread. Raises OSError."""
        opened: list[MovingFiles] = []
        while self._found and len(opened) < FOLDERS_PER_STEP:
            channel_id = self._found.pop()
            path = self._folder / channel_id.hex()
            if SegmentFolder(path).numbers() and not self.is_taken(channel_id):
                files = self._open_files(channel_id)
                files.open_left()
                files.look(0, EPOCH_MAX, None)
                opened.append(files)
        return opened

    def condemn(self, channel_id: bytes) -> None:
        """Note that the channel was deleted. `delete_condemned` deletes its objects and its folder."""
        self._condemned.append(channel_id)

    async def delete_condemned(self, in_thread: ThreadCall) -> None:
        """Delete the objects and folders of deleted channels. Raises OSError."""
        while self._condemned:
            channel_id = self._condemned[0]
            while await in_thread(lambda channel_id=channel_id: self._delete_some(channel_id)):  # type: ignore[misc]
                pass  # each step deletes some objects
            self._condemned.pop(0)

    def _delete_some(self, channel_id: bytes) -> list[str]:
        """Delete some objects of a channel, and the folder after the last one. Returns the names. Blocks its thread."""
        path = self._folder / channel_id.hex()
        if not (path / _DELETED_FILE).exists():  # with this file, the next process continues the deletion
            path.mkdir(mode=0o700, parents=True, exist_ok=True)
            (path / _DELETED_FILE).touch(mode=0o600)
            sync_folder(path)
        names = []
        for one in self._store.find(f"{OBJECTS}/{path.name}/"):
            name = one.name.rpartition("/")[2]
            if segment_named(name) is None and stop_named(name) is None:  # the archive has not made this object
                continue
            names.append(one.name)
            if len(names) == OBJECTS_PER_DELETION:
                break
        self._store.delete(names)
        if not names:
            shutil.rmtree(path)
        return names


def _channel_of(path: Path) -> bytes | None:
    try:
        return bytes.fromhex(path.name) if path.is_dir() else None
    except ValueError:
        return None
