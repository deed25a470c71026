"""The bytes that the archive of a host uses on its disk: their limit, and the share of each caller."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from pathlib import Path
from typing import NamedTuple

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.archive.segment_files import BLOCK_BYTES
from stampede_rt_channel_host.core.archive import HEAD_BYTES, decode_head
from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.quotas.limits import LIMIT_MAX, Quota

FOLDER_BYTES = 2**18
"""A channel's folder counts as its files and this number of bytes, because folders and files also take inodes."""
_FACTS_BYTES_MAX = 2**16


class FoundFolder(NamedTuple):
    """The folder of a channel as it is on the disk. `created_by`: the creator of the channel; empty: unknown."""

    channel_id: bytes
    created_by: str
    bytes: int


class DiskUse:
    """The bytes of all folders of channels together. Folders of deleted channels count, because they stay.

    `account_of` gives the account of a caller. Accepted items count before they are written.
    """

    def __init__(
        self, bytes_max: int = LIMIT_MAX, account_of: Callable[[str], Account] = lambda created_by: unlimited()
    ) -> None:
        self.used_bytes = 0
        self.bytes_max = bytes_max
        self.on_full: Callable[[], None] = _ignore
        """Called when the limit refuses a write, because the archive may have files to delete."""
        self._account_of = account_of
        self._channels: dict[bytes, ChannelDiskUse] = {}

    def of_channel(self, channel_id: bytes, created_by: str) -> ChannelDiskUse:
        """The use of a channel that the caller `created_by` has created."""
        found = self._channels.get(channel_id)
        return found or ChannelDiskUse(self, channel_id, created_by, self._account_of(created_by))

    def update(self, folders: Iterable[FoundFolder], left_out: Set[bytes] = frozenset()) -> None:
        """Count the folders as they are on the disk now, except the folders of the channels `left_out`."""
        gone = self._channels.keys() - left_out
        for one in folders:
            if one.channel_id not in left_out:
                gone -= {one.channel_id}
                self.of_channel(one.channel_id, one.created_by).set_bytes(one.bytes)
        for channel_id in gone:
            self._channels[channel_id].set_bytes(0)

    def add_bytes(self, channel: ChannelDiskUse, added_bytes: int) -> None:
        """Count further bytes of a channel. `added_bytes` may be negative."""
        self.used_bytes += added_bytes
        if channel.charged_bytes:
            self._channels[channel.channel_id] = channel
        else:
            self._channels.pop(channel.channel_id, None)

    def check(self, added_bytes: int) -> None:
        """Raises Overloaded if the archive has no room for `added_bytes`."""
        if self.used_bytes + added_bytes > self.bytes_max:
            raise Overloaded(
                f"the archive of the host has {self.used_bytes} bytes on its disk, and needs {added_bytes} more, of at "
                f"most {self.bytes_max} (--archive-bytes-max, or max_archive of st.host); record less (archive, "
                "archive_bytes), use another host, or have an operator delete the folders of deleted channels",
                metadata={"archive_bytes_max": str(self.bytes_max)},
            )


class ChannelDiskUse:
    """The bytes of one channel's folder. They also count for the caller that created the channel.

    `bytes`: on the disk. `unwritten_bytes`: the most bytes that the accepted items will add to the folder.
    `archive_bytes`: the channel's own limit, or None. `charged_bytes`: the greatest size that the folder can reach with
    these items. A channel that uses three quarters of its own limit is charged for the whole limit. It can then always
    continue, because it deletes its oldest file for each new one.
    """

    __slots__ = (
        "_account", "_charge", "_disk", "_largest_run_bytes", "archive_bytes", "bytes", "channel_id", "charged_bytes",
        "unwritten_bytes",
    )  # fmt: skip

    def __init__(self, disk: DiskUse, channel_id: bytes, created_by: str, account: Account) -> None:
        self.channel_id = channel_id
        self.bytes = self.unwritten_bytes = self.charged_bytes = self._largest_run_bytes = 0
        self.archive_bytes: int | None = None
        self._disk, self._account = disk, account
        self._charge = account.charge_for(Quota.BYTES_ARCHIVED)

    def set_bytes(self, bytes_: int) -> None:
        """Report the bytes of the folder on the disk; 0: there is no folder."""
        self.bytes = bytes_
        self._update()

    def set_unwritten(self, unwritten_bytes: int, run_bytes: int = 0) -> None:
        """Report the bytes that are still to be written. `run_bytes`: the size of the last accepted run."""
        self.unwritten_bytes = unwritten_bytes
        self._largest_run_bytes = max(self._largest_run_bytes, run_bytes) if unwritten_bytes else 0
        self._update()

    def check(self, run_bytes: int = 1) -> None:
        """Raises Overloaded if the archive has no room for a run of `run_bytes` on the disk."""
        largest = max(self._largest_run_bytes, run_bytes)
        growth = self._size_max(self.unwritten_bytes + run_bytes, largest) - self.charged_bytes
        if growth <= 0:
            return
        try:
            self._disk.check(growth)
            self._account.check(Quota.BYTES_ARCHIVED, growth)
        except Overloaded:
            self._disk.on_full()
            raise

    def _update(self) -> None:
        before, self.charged_bytes = self.charged_bytes, self._size_max(self.unwritten_bytes, self._largest_run_bytes)
        self._disk.add_bytes(self, self.charged_bytes - before)
        self._charge.set(self.charged_bytes)

    def _size_max(self, unwritten_bytes: int, run_bytes_max: int) -> int:
        """The greatest size of the folder after `unwritten_bytes` more, in runs of at most `run_bytes_max`."""
        own = self.archive_bytes
        total = unwritten_bytes + (self.bytes or (FOLDER_BYTES if unwritten_bytes else 0))
        if own is None or total < own * 3 // 4:
            return total
        last_file = own // 8 + BLOCK_BYTES + run_bytes_max  # the limit never deletes this file, however large it is
        return max(self.bytes, FOLDER_BYTES + own, min(total, FOLDER_BYTES + last_file))


def folders_of_channels(path: Path) -> Iterator[FoundFolder]:
    """The folders of channels in `path`. Blocks its thread. Leaves out all other entries."""
    with os.scandir(path) as entries:
        for entry in entries:
            try:
                channel_id = bytes.fromhex(entry.name)
                with os.scandir(entry.path) as files:
                    sizes = {file.path: file.stat(follow_symlinks=False).st_size for file in files}
            except (OSError, ValueError):  # a file of somebody else, or a folder that was deleted meanwhile
                continue
            yield FoundFolder(channel_id, _creator(sizes), FOLDER_BYTES + sum(sizes.values()))


def _creator(sizes: Mapping[str, int]) -> str:
    """The caller that created the channel of these files, by the first file that names it; empty: no file does."""
    for path in sorted(one for one in sizes if one.endswith(".segment")):
        try:
            with open(path, "rb", buffering=0) as file:
                head = decode_head(file.read(HEAD_BYTES))
                length = 0 if head is None else min(head.content_bytes, _FACTS_BYTES_MAX)
                facts = json.loads(file.read(length))
        except (OSError, ValueError):
            continue
        if isinstance(facts, dict) and isinstance(facts.get("created_by"), str):
            return str(facts["created_by"])
    return ""


def _ignore() -> None:
    """Does nothing, because there are no files to delete."""
