"""Makes a page of a host's channels with their status, in pieces: a host may have a hundred thousand channels."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from stampede_rt.v1 import channel_pb2
from stampede_rt_channel_host.channels.channel_status import channel_status
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import Pieces

NAMES_PER_PIECE = 256
STATUSES_PER_PIECE = 32
"""Fewer statuses than names, because to make a status takes about as long as to match eight names."""


class Page(NamedTuple):
    """Channels, sorted by name. `has_more`: whether other channels with matching names follow."""

    channels: list[channel_pb2.ChannelStatus]
    has_more: bool


def page_of(store: ChannelStore, matches: Callable[[str], object], after: str, size: int) -> Pieces[Page]:
    """At most `size` channels whose names match and follow the name `after`.

    Each status is as of the moment at which the host looked at that channel.
    """
    shown: list[channel_pb2.ChannelStatus] = []
    while found := store.named_after(after, NAMES_PER_PIECE):
        for hosted in found:
            after = hosted.record.name
            if not matches(after):
                continue
            if len(shown) == size:
                return Page(shown, has_more=True)
            shown.append((yield from channel_status(hosted, store.now, store.readers.dropped(after), store.multicasts)))
            if len(shown) % STATUSES_PER_PIECE == 0:
                yield
        yield
    return Page(shown, has_more=False)
