"""The rings of one connection: memory that hosts of this machine share with it (decision 0168).

A read that a ring can answer makes no call. All other reads ask the host. The answers are the same.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from stampede_rt._async.endpoints import EndpointPool
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import InvalidArgument, Overloaded, StampedeError, Unavailable
from stampede_rt.transports import futexes
from stampede_rt.transports.concurrency_async import monotonic_s
from stampede_rt.transports.ring_mapping import ChannelNotShared, RingMapping
from stampede_rt.transports.ring_waiting_async import RingWaits
from stampede_rt.transports.socket_routes import memory_not_shared

Perform = Callable[
    [Any, Callable[[Binding, float], Awaitable[RingMapping | None]], float], Awaitable[RingMapping | None]
]
"""`Session.perform`. Its first argument is the state of a channel's handle."""

READS_BEFORE = 8  # a ring costs the host memory, so the client asks for one only after this many reads of a channel
OPEN_S = 1.0  # the time limit for opening a ring
RETRY_PAUSE_S = 1.0  # the pause after a ring has ended, or could not be opened for a reason that may pass
REFUSED_PAUSE_S = 30.0  # the pause after the host has refused a ring
# Above this number the connection gives up the ring of the channel that it has known for the longest time.
RINGS_MAX = 64
CHANNELS_MAX = 4096  # the most channels whose reads are counted


@dataclass(slots=True)
class _KnownChannel:
    """The ring of one channel, if there is one, and the earliest time at which to ask for a ring."""

    mapping: RingMapping | None = None
    reads: int = 0
    not_before_s: float = 0.0
    is_opening: bool = False


class SharedRings:
    """Opens rings, and gives them up."""

    def __init__(self, endpoints: EndpointPool, perform: Perform, transport: Transport) -> None:
        """Raises InvalidArgument if the program has chosen shared memory on a system without it."""
        self._endpoints, self._perform = endpoints, perform
        self._is_forced = transport is Transport.SHARED
        self._may_use = transport in (Transport.BEST, Transport.SHARED) and futexes.is_supported()
        if self._is_forced and not self._may_use:
            raise InvalidArgument('transport="shared" needs Linux on x86-64 and CPython; leave the argument out')
        self._channels: dict[bytes, _KnownChannel] = {}
        self._is_closed = False
        self.waits = RingWaits()

    async def find(self, state: Any) -> RingMapping | None:
        """Return the channel's ring; None: the caller must ask the host.

        Opens the ring after a few calls. The returned ring may have just ended.

        Blocks for a few seconds at most, while it opens the ring. Raises Unavailable if the program has chosen shared
        memory and the host shares none.
        """
        if not self._may_use:
            return None
        known = self._channels.get(state.info.channel_id)
        if known is None:
            known = self._channels[state.info.channel_id] = _KnownChannel()
            if len(self._channels) > CHANNELS_MAX:
                self._forget(next(iter(self._channels)))
        mapping = known.mapping
        if mapping is not None:
            if mapping.may_be_open:
                return mapping
            self._give_up(known)
        known.reads += 1
        if known.is_opening or monotonic_s() < known.not_before_s:
            return None
        if known.reads < READS_BEFORE and not self._is_forced:
            return None
        return await self._open(state, known)

    async def _open(self, state: Any, known: _KnownChannel) -> RingMapping | None:
        async def open_at(binding: Binding, limit_s: float) -> RingMapping | None:
            endpoint = self._endpoints.to(binding.target)
            mapping = await endpoint.share_memory(binding.subject_id, binding.epoch)
            if mapping is None and self._is_forced:
                raise memory_not_shared(binding.target)
            return mapping

        known.is_opening, known.not_before_s = True, monotonic_s() + RETRY_PAUSE_S
        try:
            mapping = await self._perform(state, open_at, OPEN_S)
        except ChannelNotShared:
            mapping, known.not_before_s = None, monotonic_s() + REFUSED_PAUSE_S
        except (Unavailable, Overloaded):
            if self._is_forced:
                raise
            mapping, known.not_before_s = None, monotonic_s() + REFUSED_PAUSE_S
        except StampedeError:  # the read asks the host, and gets the error from it
            mapping = None
        finally:
            known.is_opening = False
        if mapping is not None:
            self._keep(known, mapping)
        return known.mapping

    def _keep(self, known: _KnownChannel, mapping: RingMapping) -> None:
        known.mapping = mapping
        if self._is_closed or all(one is not known for one in self._channels.values()):  # dropped meanwhile
            self._give_up(known)
        open_ones = [one for one in self._channels.values() if one.mapping is not None]
        for one in open_ones[:-RINGS_MAX]:
            self._give_up(one)

    def _forget(self, channel_id: bytes) -> None:
        self._give_up(self._channels.pop(channel_id))

    def _give_up(self, known: _KnownChannel) -> None:
        mapping, known.mapping = known.mapping, None
        if mapping is not None:
            mapping.close()

    def close(self) -> None:
        """Give up all rings, and end the waits for them."""
        self._is_closed = True
        for known in tuple(self._channels.values()):
            self._give_up(known)
        self.waits.close()
