"""Gives the channels of a host their archive, in a folder and perhaps in an object store."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.wire.run_slices import slice_run
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.disk_use import DiskUse
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.objects.object_archive import ObjectArchive, ObjectSettings
from stampede_rt_channel_host.channels.joined_runs import joined_runs
from stampede_rt_channel_host.channels.recordings import Recordings
from stampede_rt_channel_host.copies.messages import run_of
from stampede_rt_channel_host.copies.owner_messages import retries_of, retries_to
from stampede_rt_runtime.quotas.accounts import Accounts
from stampede_rt_runtime.quotas.limits import Quota


def set_up_archive(
    recordings: Recordings,
    folder: ArchiveFolder | None,
    objects: ObjectSettings | None,
    accounts: Accounts,
    now: Callable[[], int],
) -> None:
    """Give the recorded channels of a host their archive. `folder` None: the host has none. Blocks its thread."""
    recordings.archive = None if folder is None else _archive(folder, objects, accounts, now)
    recordings.write_retries = lambda window: retries_to(window, now())
    recordings.read_retries = lambda encoded: retries_of(encoded, now())


def _archive(
    folder: ArchiveFolder, objects: ObjectSettings | None, accounts: Accounts, now: Callable[[], int]
) -> HostArchive:
    found = [*folder.of_channels()]
    cached = 0 if objects is None else objects.cache_bytes_max
    disk = DiskUse(folder.limit_bytes(sum(one.bytes for one in found), cached), accounts.of)
    accounts.set_default(Quota.BYTES_ARCHIVED, disk.bytes_max * 7 // 8)
    disk.update(found)
    stored = None if objects is None else ObjectArchive(objects, folder, slice_run, now)
    return HostArchive(folder, run_of, disk, now, stored, joined_runs)
