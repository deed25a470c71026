"""Subscriptions: items as the host sends them, resumed by themselves when the connection or the place is lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from types import TracebackType
from typing import Any

from stampede_rt._async.session import ChannelState, Session
from stampede_rt.binding import Binding
from stampede_rt.errors import IncarnationLost, InvalidArgument, StampedeError
from stampede_rt.handles import OfOneProcess
from stampede_rt.model import Item
from stampede_rt.reading import SubscribeMode
from stampede_rt.timeline import Bound
from stampede_rt.transports.concurrency_async import begin_now
from stampede_rt.transports.grpc_async import Stream
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import item_pb2
from stampede_rt.wire.reads import bound_to_message, position_of
from stampede_rt.wire.runs import ItemDecoder

_MODES = {"all": channel_pb.SUBSCRIBE_MODE_ALL, "newest": channel_pb.SUBSCRIBE_MODE_NEWEST}


class Subscription(OfOneProcess):
    """An iterator over items (see `Channel.subscribe`), and a context manager.

    `skipped` counts what "newest" passed over, `dropped` what retention collected before a slow reader took it.
    `close` may be called from any thread; then the iteration ends. Raises IncarnationLost when the channel's host was
    lost and items with it: subscribe again to go on with the new incarnation.
    """

    def __init__(self, session: Session, state: ChannelState, request: channel_pb.SubscribeRequest) -> None:
        self._session = session
        self._state = state
        self._request = request
        self._stream: Stream[channel_pb.SubscribeResponse] | None = None
        self._responses: Any = None
        self._decoder: ItemDecoder | None = None
        self._ready: deque[Item] = deque()
        self._last: Item | None = None
        self._incarnation = request.after.incarnation if request.HasField("after") else 0
        self._next_seq: int | None = None  # everything below was delivered or reported
        self._place: item_pb2.ItemPosition | None = None  # to resume from through a group; seqs come in any order there
        self._since_place: set[int] = set()  # seqs that came since, which come again: a part of one step at the host
        self._skipped_before = 0  # of streams that ended; the host counts anew on each
        self._closed = False
        self.skipped = 0
        self.dropped = 0

    @classmethod
    def begin(
        cls,
        session: Session,
        state: ChannelState,
        *,
        start: Bound | None,
        mode: SubscribeMode,
        after: Item | None,
        payloads: bool,
        group_id: bytes | None = None,
    ) -> Subscription:
        """Check the arguments and make the subscription."""
        if mode not in _MODES:
            raise InvalidArgument(f'mode is {mode!r}; write "all" or "newest"')
        if start is not None and after is not None:
            raise InvalidArgument("start and after exclude each other: after resumes a subscription, start begins one")
        if after is not None and not isinstance(after, Item):
            raise InvalidArgument(f"after is {after!r}; give the last Item received, or use start for a time")
        request = channel_pb.SubscribeRequest(
            mode=_MODES[mode],
            start=None if start is None else bound_to_message(start),
            after=None if after is None else position_of(after),
            without_payloads=not payloads,
            group_id=group_id,
        )
        self = cls(session, state, request)
        begin_now(self._open)
        return self

    def __repr__(self) -> str:
        state = self._session.state or ("closed" if self._closed else "")
        return f"<Subscription to channel {self._state.info.name!r}{f', {state}' if state else ''}>"

    async def __aenter__(self) -> Subscription:
        self._session.check_process()
        await self._open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __aiter__(self) -> Subscription:
        return self

    async def __anext__(self) -> Item:
        self._session.check_process()
        while not self._ready or self._closed:
            if self._closed:
                raise StopAsyncIteration
            await self._open()
            await self._receive()
        self._last = item = self._ready.popleft()
        return item

    def close(self) -> None:
        """End the subscription; callable from any thread."""
        self._closed = True
        stream = self._stream
        if stream is not None:
            stream.cancel()

    async def _open(self) -> None:
        """Begin, or resume at the channel's present place, and wait until the host holds the subscription."""
        if self._stream is not None or self._closed:
            return

        async def open_at(binding: Binding) -> None:
            self._request.channel_id, self._request.epoch = binding.channel_id, binding.epoch
            port = self._session.ports.to(binding.target)
            stream = port.stream(port.channels.Subscribe, self._request)
            responses = stream.__aiter__()
            first = await responses.__anext__()
            self._stream, self._responses = stream, responses
            if self._closed:  # while it was being opened
                stream.cancel()
            self._opened(first.opened)
            self._take(first)

        await self._session.perform(self._state, open_at)

    def _opened(self, opened: channel_pb.SubscriptionOpened) -> None:
        if self._incarnation and opened.incarnation != self._incarnation:
            raise IncarnationLost(
                f"the host of channel {self._state.info.name!r} was lost, and what it held; everything after seq "
                f"{self._next_seq or 'unknown'} may be missing: subscribe again to go on with the new incarnation"
            )
        self._incarnation = opened.incarnation
        if self._next_seq is None and not self._request.HasField("start"):
            self._next_seq = opened.next_seq
        self._decoder = self._state.decoder(opened.incarnation, payloads=not self._request.without_payloads)

    async def _receive(self) -> None:
        try:
            self._take(await self._responses.__anext__())
        except StopAsyncIteration:  # closed, or a step before was cancelled, and its call with it
            self._stream = None
            self._resume()
        except StampedeError as error:
            self._stream = None
            if not error.retryable:
                self._closed = True
                raise
            self._session.cache.forget(self._state.info.channel_id)
            self._resume()

    def _resume(self) -> None:
        """What to ask for so that nothing is missed and nothing comes twice."""
        self._skipped_before = self.skipped
        if self._place is not None:
            self._request.ClearField("start")
            self._request.after.CopyFrom(self._place)
        elif self._next_seq:
            self._request.ClearField("start")
            time = self._last.time if self._last else 0
            position = item_pb2.ItemPosition(time_unix_nano=time, seq=self._next_seq - 1, incarnation=self._incarnation)
            self._request.after.CopyFrom(position)

    def _take(self, response: channel_pb.SubscribeResponse) -> None:
        if response.HasField("gap"):
            self.dropped += response.gap.items
            self._next_seq = response.gap.last_seq + 1
        if response.runs and self._decoder is not None:
            self._ready.extend(self._unseen(self._decoder.decode_each(response.runs)))
        if response.HasField("resume_after"):
            self._place = response.resume_after
            if not response.HasField("opened"):  # which repeats where it was told to begin
                self._since_place.clear()
        if response.HasField("progress"):
            self.skipped = self._skipped_before + response.progress.skipped
            self._next_seq = max(self._next_seq or 0, response.progress.next_seq)

    def _unseen(self, items: list[Item]) -> Iterator[Item]:
        newest_only = self._request.mode == channel_pb.SUBSCRIBE_MODE_NEWEST
        for item in items:
            self._next_seq = max(self._next_seq or 0, item.seq + 1)
            last = self._ready[-1] if self._ready else self._last
            if newest_only and last is not None and (item.time, item.seq) <= (last.time, last.seq):
                continue
            if self._place is not None:
                if item.seq in self._since_place:
                    continue
                self._since_place.add(item.seq)
            yield item
