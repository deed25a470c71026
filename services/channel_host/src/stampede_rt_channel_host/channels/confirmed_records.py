"""Asks the directory for the record of a channel, so that no answer from before a registration counts."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.cluster.directory import DirectoryQueries
from stampede_rt_channel_host.core.records import RecordedChannel

LOOKUPS_MAX = 3  # the most lookups of one record: the host repeats a lookup during which it registered


async def confirmed_record(
    directory: DirectoryQueries, channel_id: bytes, registrations: Callable[[], int], host_name: str
) -> RecordedChannel:
    """The record of the channel. Asks again if the host registers before the answer comes.

    Such an answer may be out of date: the lease ended before the host registered again, and the channel may have got a
    new owner meanwhile. `registrations` returns the number of registrations up to now. Raises the error that the
    directory answers. Raises StaleBinding if the host registered during each of LOOKUPS_MAX lookups.
    """
    for _ in range(LOOKUPS_MAX):
        before = registrations()
        record = await directory.resolve(channel_id)
        if before == registrations():
            return record
    raise refusals.fenced(host_name)
