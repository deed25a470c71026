"""Single puts: each waits for its ack, on a stream that its thread keeps open to the channel's host."""

from __future__ import annotations

from collections.abc import Mapping

from stampede_rt._async.session import CALL_TIMEOUT_S, ChannelState, Session
from stampede_rt.binding import Binding
from stampede_rt.model import Item
from stampede_rt.payloads import check_attributes, check_payload
from stampede_rt.reading import Wait
from stampede_rt.status import from_error_message
from stampede_rt.timeline import DurationLike, InstantLike, parse_instant, parse_item_duration
from stampede_rt.transports.concurrency_async import Mutex, thread_id
from stampede_rt.transports.grpc_async import PutExchange
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import item_pb2

STREAMS_MAX = 256


class PutStreams:
    """The open put streams of one handle, one for each thread and place of the channel."""

    def __init__(self, session: Session, state: ChannelState) -> None:
        self._session = session
        self._state = state
        self._streams: dict[int, tuple[Binding, PutExchange]] = {}
        self._mutex = Mutex()

    async def put(
        self,
        number: int,
        payload: bytes,
        time: InstantLike | None,
        duration: DurationLike | int | None,
        attributes: Mapping[str, str] | None,
        content_type: str | None,
        timeout: float | None,
    ) -> Item:
        """Put one item under the producer's `number`, which makes it safe to send it again."""
        run = single_run(payload, time, duration, attributes, content_type)
        wait = Wait.parse(timeout)
        put = channel_pb.PutRun(first_number=number, run=run)
        if wait.seconds is not None:
            put.wait_nanos = wait.nanos
        blocks = self._state.info.policy.on_full == "block"
        wait_s = wait.seconds if blocks else 0.0
        limit_s = None if wait_s is None else wait_s + CALL_TIMEOUT_S

        async def put_at(binding: Binding) -> Item:
            ack = await self._stream(binding).put(self._request(binding, put), limit_s)
            return self._accepted(run, ack)

        return await self._session.perform(self._state, put_at, limit_s)

    def _stream(self, binding: Binding) -> PutExchange:
        key = thread_id()
        entry = self._streams.get(key)
        if entry is not None and entry[0] is binding and not entry[1].broken:
            return entry[1]
        stream = self._session.ports.to(binding.target).puts()
        with self._mutex:
            if len(self._streams) >= STREAMS_MAX:
                self._streams.pop(next(iter(self._streams)))[1].cancel()
            self._streams[key] = (binding, stream)
        return stream

    def _request(self, binding: Binding, put: channel_pb.PutRun) -> channel_pb.PutRequest:
        return channel_pb.PutRequest(
            channel_id=binding.channel_id, epoch=binding.epoch, producer_id=self._state.producer_id, puts=(put,)
        )

    def _accepted(self, run: item_pb2.ItemRun, ack: channel_pb.PutAck) -> Item:
        if ack.HasField("error"):
            raise from_error_message(ack.error)
        if ack.rejections:
            raise from_error_message(ack.rejections[0].error)
        duration = run.duration_nanos[0] if run.duration_nanos else None
        time = ack.stamped_unix_nano if ack.HasField("stamped_unix_nano") else run.time_unix_nano[0]
        return Item(
            time,
            None if duration is None else time + duration,
            duration,
            ack.first_seq,
            run.payloads,
            dict(run.attributes),
            run.content_type or self._state.info.policy.content_type or "",
            len(run.payloads),
            ack.incarnation,
        )


def single_run(
    payload: bytes,
    time: InstantLike | None,
    duration: DurationLike | int | None,
    attributes: Mapping[str, str] | None,
    content_type: str | None,
) -> item_pb2.ItemRun:
    """A run of one item. Raises InvalidArgument for what the wire cannot carry."""
    payload = check_payload(payload)
    check_attributes(attributes)
    nanos = parse_item_duration(duration)
    return item_pb2.ItemRun(
        time_unix_nano=() if time is None else (parse_instant(time),),
        duration_nanos=() if nanos is None else (nanos,),
        payload_length_bytes=(len(payload),),
        content_type=content_type or "",
        attributes=attributes,
        payloads=payload,
    )
