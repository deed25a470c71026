"""Consumption: a channel can keep its items until all consumers have consumed them (paper, section 3.4).

The consumer is the connection. All its handles of a channel share one consumer place. Each `consume` renews the lease
of the place. Between calls the client renews it in the background, until the connection is closed. If a process dies,
its places end with their leases.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.session import CALL_TIMEOUT_S, Session
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import DeadlineExceeded, InvalidArgument, StampedeError
from stampede_rt.transports.concurrency_async import BackgroundTask, Mutex, Signal
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.values.model import Item
from stampede_rt.wire.reads import check_item

SEQS_MAX = 4096  # the most seqs of one request
RENEWALS_PER_LEASE = 3
END_TIMEOUT_S = 1.0
_log = logging.getLogger("stampede_rt")


async def consume(session: Session, state: ChannelState, items: Item | Iterable[Item]) -> int:
    """See `Channel.consume`."""
    seqs = _seqs_by_incarnation([items] if isinstance(items, Item) else items)
    consumed, lease_s = 0, 0.0
    for incarnation, chunk in seqs:
        response = await _consume(session, state, incarnation, chunk)
        consumed += response.consumed
        lease_s = response.lease_nanos / 1e9
    kept = session.consumer_places.setdefault(state.info.channel_id, _HeldConsumerPlace(session, state))
    assert isinstance(kept, _HeldConsumerPlace), "only held places are stored there"
    kept.keep(lease_s)
    return consumed


def _seqs_by_incarnation(items: Iterable[Item]) -> list[tuple[int, Sequence[int]]]:
    """Return an incarnation and at most SEQS_MAX seqs of it for each request.

    Without items, return one request without seqs. That request only takes or renews the place.
    """
    if not isinstance(items, Iterable):
        raise InvalidArgument(f"{items!r} cannot be consumed; give items from a read or subscription")
    found: dict[int, list[int]] = {}
    for item in items:
        if not isinstance(item, Item):
            raise InvalidArgument(f"{item!r} cannot be consumed; give items from a read or subscription")
        check_item(item)
        found.setdefault(item.incarnation, []).append(item.seq)
    requests: list[tuple[int, Sequence[int]]] = [
        (incarnation, seqs[first : first + SEQS_MAX])
        for incarnation, seqs in found.items()
        for first in range(0, len(seqs), SEQS_MAX)
    ]
    return requests or [(0, ())]


async def _consume(
    session: Session,
    state: ChannelState,
    incarnation: int = 0,
    seqs: Sequence[int] = (),
    lease_nanos: int | None = None,
    timeout_s: float = CALL_TIMEOUT_S,
) -> channel_pb.ConsumeResponse:
    """Send one request, and send it again after a break. Consuming an item twice changes nothing."""

    async def consume_at(binding: Binding, left_s: float) -> channel_pb.ConsumeResponse:
        endpoint = session.endpoints.to(binding.target)
        request = channel_pb.ConsumeRequest(
            channel_id=binding.subject_id,
            epoch=binding.epoch,
            consumer_id=session.consumer_id,
            seqs=seqs,
            incarnation=incarnation,
            lease_nanos=lease_nanos,
        )
        response: channel_pb.ConsumeResponse = await endpoint.call(endpoint.channels.Consume, request, left_s)
        return response

    return await session.perform(state, consume_at, timeout_s)


class _HeldConsumerPlace:
    """Renews the lease of the connection's place at one channel, and gives the place up when the connection closes."""

    def __init__(self, session: Session, state: ChannelState) -> None:
        self._session = session
        self._state = state
        self._mutex = Mutex()
        self._stop = Signal()
        self._lease_s = 0.0
        self._background: BackgroundTask | None = None

    def keep(self, lease_s: float) -> None:
        """Note that the place was taken or renewed for `lease_s` seconds, and begin to renew it in the background."""
        with self._mutex:
            self._lease_s = lease_s
            if self._background is None:
                self._session.attach(self)
                self._background = BackgroundTask(self._run, f"consumer of {self._state.info.name}")

    async def end(self) -> None:
        """Give the place up. Without this, another consumer could take the place only at the end of the lease.

        The connection calls this when it closes.
        """
        self._stop.set()
        if self._background is None or not await self._background.join(END_TIMEOUT_S):
            return
        try:
            await _consume(self._session, self._state, lease_nanos=0, timeout_s=END_TIMEOUT_S)
        except StampedeError as error:
            _log.info(
                "the consumer place at channel %s could not be given up; it ends with its lease: %s",
                self._state.info.name,
                error,
            )

    async def _run(self) -> None:
        try:
            while not await self._stop.wait(self._lease_s / RENEWALS_PER_LEASE):
                await self._renew()
        except StampedeError as error:
            if not self._session.closed:
                _log.warning("the consumer place at channel %s is lost: %s", self._state.info.name, error)
            self._session.consumer_places.pop(self._state.info.channel_id, None)
            self._session.detach(self)

    async def _renew(self) -> None:
        """Renew the lease. After a retryable error only logs the error, because `_run` renews again soon.

        Raises any other error, for example if the channel is deleted or if other consumers have all places.
        """
        try:
            response = await _consume(self._session, self._state, timeout_s=self._lease_s / RENEWALS_PER_LEASE)
            self._lease_s = response.lease_nanos / 1e9
        except StampedeError as error:
            if self._session.closed or not (error.retryable or isinstance(error, DeadlineExceeded)):
                raise
            _log.info(
                "the consumer place at channel %s could not be renewed; the client tries again: %s",
                self._state.info.name,
                error,
            )
