"""The channels that a host multicasts: at least one reader of each wants multicast."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.multicast.channel_multicast import ChannelMulticast
from stampede_rt_channel_host.channels.multicast.group_socket import MulticastGroup

logger = logging.getLogger(__name__)


class Multicasts:
    """Begins to multicast a channel with its first reader, and ends with its last reader. Used on the host's event
    loop.

    `repairs`: the requests of all readers so far for items that no datagram brought.
    """

    def __init__(self, group: MulticastGroup, now: Callable[[], int]) -> None:
        self.group, self._now = group, now
        self._channels: dict[HostedChannel, tuple[ChannelMulticast, asyncio.Task[None]]] = {}
        self._ending: set[asyncio.Task[None]] = set()
        self.repairs = 0

    def __len__(self) -> int:
        return len(self._channels)

    @property
    def readers(self) -> int:
        """The subscriptions of all channels whose readers may receive the datagrams."""
        return sum(one.readers for one, _ in self._channels.values())

    def find(self, hosted: HostedChannel) -> ChannelMulticast | None:
        """The multicast of this channel; None: the host does not multicast the channel."""
        found = self._channels.get(hosted)
        return None if found is None or found[0].has_ended else found[0]

    @contextmanager
    def reading(self, hosted: HostedChannel) -> Iterator[ChannelMulticast]:
        """Multicast the channel for one more reader, for the duration of the block."""
        one = self.find(hosted) or self._begin(hosted)
        one.join()
        try:
            yield one
        finally:
            one.leave()
            if not one.readers:
                self._end(hosted, one)

    def _begin(self, hosted: HostedChannel) -> ChannelMulticast:
        made = ChannelMulticast(hosted, self.group, self._now)
        task = asyncio.create_task(made.run(), name="multicast")
        task.add_done_callback(_log_defect)
        self._channels[hosted] = made, task
        return made

    def _end(self, hosted: HostedChannel, one: ChannelMulticast) -> None:
        found = self._channels.get(hosted)
        if found is not None and found[0] is one:
            del self._channels[hosted]
            if one.has_ended:
                self._ending.add(found[1])  # the task still tells readers of the end, and ends by itself
                found[1].add_done_callback(self._ending.discard)
            else:
                found[1].cancel()

    def close(self) -> None:
        """End all multicasts, and close the socket."""
        for task in (*self._ending, *(task for _, task in self._channels.values())):
            task.cancel()
        self._channels.clear()
        self.group.close()


def _log_defect(task: asyncio.Task[None]) -> None:
    """Log a defect. The readers get no more datagrams, and continue without them."""
    if not task.cancelled() and (failure := task.exception()) is not None:
        logger.error("the multicast of a channel has failed", exc_info=failure, extra={"event": "multicast_failed"})
