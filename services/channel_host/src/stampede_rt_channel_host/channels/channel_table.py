"""The table of the channels of one host, by id and sorted by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import islice
from typing import Any

from sortedcontainers import SortedList

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.creation_shares import CreationShares
from stampede_rt_channel_host.core.channel import Pieces, batched_keys, one_after_another
from stampede_rt_channel_host.core.records import RecordedChannel

CHANNELS_MAX = 100_000
CHANNELS_COMPARED_PER_PIECE = 32  # it takes up to 50 us to log and drop one
RECORDS_PER_PIECE = 64  # it takes 5 to 15 us to decode a record
_ID_END = b"\xff" * 17  # above every id
Compare = Callable[[HostedChannel, RecordedChannel | None], list[Pieces[None]]]


class ChannelTable(Mapping[bytes, HostedChannel]):
    """The channels and copies of one host, by id: CHANNELS_MAX at most, and a part of these for each caller."""

    def __init__(self, host_name: str) -> None:
        self._host_name = host_name
        self.registrations = 0
        """The number of the host's registrations whose answers have come."""
        self._by_id: dict[bytes, HostedChannel] = {}
        self._names: Any = SortedList()  # the name of each channel, with the channel's id
        self._shares = CreationShares(host_name, "channels", CHANNELS_MAX)

    def __getitem__(self, channel_id: bytes) -> HostedChannel:
        return self._by_id[channel_id]

    def __iter__(self) -> Iterator[bytes]:
        return iter(self._by_id)

    def __len__(self) -> int:
        return len(self._by_id)

    def check_room(self, created_by: str) -> None:
        """Raises Overloaded if the host has too many channels, or too many of this caller."""
        if len(self._by_id) >= CHANNELS_MAX:
            raise Overloaded(f"host {self._host_name} has {CHANNELS_MAX} channels, the limit; use another host")
        self._shares.check(created_by)

    def version_of(self, channel_id: bytes) -> object:
        """Changes with each registration, and when the host gets, drops or replaces the channel, or learns of another
        epoch.
        """
        hosted = self._by_id.get(channel_id)
        return self.registrations, hosted, 0 if hosted is None else hosted.epoch

    def add(self, hosted: HostedChannel) -> None:
        """Add a channel."""
        record = hosted.record
        self._by_id[record.channel_id] = hosted
        self._names.add((record.name, record.channel_id))
        self._shares.note(record.created_by, +1)

    def remove(self, hosted: HostedChannel) -> None:
        """Remove a channel."""
        record = hosted.record
        del self._by_id[record.channel_id]
        self._names.remove((record.name, record.channel_id))
        self._shares.note(record.created_by, -1)

    def named_after(self, name: str, count: int) -> list[HostedChannel]:
        """The first `count` channels whose names follow `name`, sorted by name."""
        later = self._names.irange(minimum=(name, _ID_END), inclusive=(False, True))
        return [self._by_id[channel_id] for _, channel_id in islice(later, count)]

    def batches(self, count: int) -> Iterator[list[HostedChannel]]:
        """All channels sorted by name, `count` at a time. The table may change between two batches."""
        for names in batched_keys(self._names, count):
            found = [self._by_id.get(channel_id) for _, channel_id in names]
            yield [one for one in found if one is not None]


def comparing(
    table: ChannelTable, records: Iterable[RecordedChannel], registration: int, compare: Compare,
    begin: Callable[[Pieces[None]], None],
) -> Pieces[None]:  # fmt: skip
    """Compare the channels of a host with the directory's answer to a registration, in pieces.

    `registration` is the number of the registration. Calls `compare` with each channel and its record, or with None if
    the answer does not name the channel. Leaves out channels with a newer record. Also leaves out copies that the
    answer does not name, because the answer names only the channels that the host owns. `begin` does the work that
    `compare` returns.
    """
    listed: dict[bytes, RecordedChannel] = {}
    unread = iter(records)
    while part := [*islice(unread, RECORDS_PER_PIECE)]:
        listed.update((record.channel_id, record) for record in part)
        yield
    for batch in table.batches(CHANNELS_COMPARED_PER_PIECE):
        left: list[Pieces[None]] = []
        for hosted in batch:
            record = listed.get(hosted.record.channel_id)
            is_owned = hosted.copy is None and not hosted.is_fallback
            if (is_owned or record is not None) and hosted.registration < registration:
                left += compare(hosted, record)
        begin(one_after_another(left))  # together, because each `begin` may start a task
        yield
