"""A message that is leased to its taker, and the ways to settle it (paper, section 3.5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from types import TracebackType
from typing import Any

from stampede_rt._async.attempts import Locator, attempt
from stampede_rt._async.session import CALL_TIMEOUT_S, Session
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import LeaseExpired, StampedeError
from stampede_rt.handles import BoundToProcess
from stampede_rt.status import from_error_message
from stampede_rt.transports.concurrency_async import monotonic_s
from stampede_rt.v1 import queue_pb2
from stampede_rt.v1 import queue_service_pb2 as queue_service_pb
from stampede_rt.values.codecs import CodecLike, HandleCodec
from stampede_rt.values.policy import duration_of
from stampede_rt.values.queueing import parse_lease, parse_reason
from stampede_rt.values.timeline import DurationLike
from stampede_rt.wire.queues import DeliveredMessage

SETTLEMENTS_MAX = 1024  # the most settlements of one request
# Verdicts that end the delivery and that the host refuses the second time, because it no longer knows the delivery. A
# second "acknowledge" is no error at the host.
_ENDING_VERDICTS = ("give_back", "terminate")


class Settler:
    """Settles the deliveries of one taker at the queue's host."""

    def __init__(self, session: Session, locator: Locator, taker_id: int) -> None:
        self._session = session
        self._locator = locator
        self._taker_id = taker_id

    async def settle(self, settlement: queue_pb2.Settlement, incarnation: int) -> queue_pb2.SettlementResult:
        """Settle one delivery. Tries again until the host answers. Blocks for at most 10 s.

        Raises LeaseExpired, Unavailable.

        Delivery ids are valid only within one incarnation of the queue. A delivery of another incarnation counts as
        expired.
        """
        tries = 0

        async def settle_at(binding: Binding, timeout_s: float) -> queue_pb2.SettlementResult:
            nonlocal tries
            tries += 1
            if binding.incarnation != incarnation:
                raise LeaseExpired("the queue's host was lost, with this and all other messages; take the next message")
            result = (await self._settle_at(binding, (settlement,), timeout_s))[0]
            if result.HasField("error"):
                error = from_error_message(result.error)
                ends_delivery = settlement.WhichOneof("verdict") in _ENDING_VERDICTS
                # An earlier try may have settled the message although its answer was lost. A later try then gets
                # LeaseExpired, which is no failure.
                if not (tries > 1 and ends_delivery and isinstance(error, LeaseExpired)):
                    raise error
            return result

        return await attempt(self._locator, settle_at, CALL_TIMEOUT_S)  # tries until the host answers

    async def give_back(self, messages: Sequence[Message], timeout_s: float) -> None:
        """Give back messages that no caller received. `max_deliveries` does not count these deliveries.

        If the call fails, the host delivers the messages again when their leases end.
        """
        for at in range(0, len(messages), SETTLEMENTS_MAX):

            async def settle_at(
                binding: Binding, left_s: float, part: Sequence[Message] = messages[at : at + SETTLEMENTS_MAX]
            ) -> Sequence[queue_pb2.SettlementResult]:
                returns = [one.give_back_settlement() for one in part if one.incarnation == binding.incarnation]
                return await self._settle_at(binding, returns, left_s) if returns else ()

            await attempt(self._locator, settle_at, timeout_s)

    async def extend(self, messages: Sequence[Message], timeout_s: float) -> list[Message]:
        """Renew the lease of each message. The new lease lasts for the message's `lease_s` seconds from now on.

        Returns the messages whose leases the host has renewed.
        """
        extended: list[Message] = []
        for at in range(0, len(messages), SETTLEMENTS_MAX):
            part = messages[at : at + SETTLEMENTS_MAX]

            async def settle_at(binding: Binding, left_s: float, part: Sequence[Message] = part) -> list[Message]:
                known = [one for one in part if one.incarnation == binding.incarnation]
                began_s = monotonic_s()
                settlements = [one.extend_settlement() for one in known]
                results = await self._settle_at(binding, settlements, left_s) if known else ()
                return [one for one, result in zip(known, results, strict=True) if one.note_extended(result, began_s)]

            extended += await attempt(self._locator, settle_at, timeout_s)
        return extended

    async def _settle_at(
        self, binding: Binding, settlements: Sequence[queue_pb2.Settlement], timeout_s: float
    ) -> Sequence[queue_pb2.SettlementResult]:
        endpoint = self._session.endpoints.to(binding.target)
        request = queue_service_pb.SettleRequest(  # the subject of this binding is the queue
            queue_id=binding.subject_id, epoch=binding.epoch, taker_id=self._taker_id, settlements=settlements
        )
        response: queue_service_pb.SettleResponse = await endpoint.call(endpoint.queues.Settle, request, timeout_s)
        return response.results


class Message(BoundToProcess):
    """A message that a queue or mailbox has leased to this taker.

    The host delivers the message again unless the taker settles it before the lease ends. The object is a context
    manager. The end of the block acknowledges the message, or gives it back if the block raised an error. If the block
    has already settled the message, its end does nothing.

    - `payload` is bytes, `value` the decoded payload, `attributes` a mapping of text to text, `content_type` a MIME
      type.
    - `seq` is the message's number in the queue, within one `incarnation` of the queue.
    - `time` is the message's time, in nanoseconds since the epoch: by default the time at which the queue accepted it.
    - `deliveries` is the number of deliveries of this message so far, with this one. If the queue has `copies`, each
      copy has a number of its own.
    - `lease_s` is the length of the lease in seconds at the delivery. `extend` does not change it.
    - `origin` says which queue a dead letter left, and why. It is None for other messages.
    """

    def __init__(
        self, settler: Settler, delivery: DeliveredMessage, incarnation: int, coding: HandleCodec | None
    ) -> None:
        self._settler = settler
        self._delivery = delivery
        self._coding = coding
        self.lease_s = delivery.lease_nanos / 1e9
        self._lease_ends_s = monotonic_s() + self.lease_s
        self._settled = False
        self.payload: bytes = delivery.payload
        self.attributes: Mapping[str, str] = delivery.attributes
        self.content_type = delivery.content_type
        self.deliveries = delivery.deliveries
        self.time = delivery.time
        self.seq = delivery.seq
        self.incarnation = incarnation
        self.origin = delivery.origin

    def __repr__(self) -> str:
        return f"<Message #{self.seq}, delivery {self.deliveries}, {len(self.payload)} bytes>"

    @cached_property
    def value(self) -> Any:
        """The payload as the handle's codec decodes it, or the payload itself without a codec. Raises CodecError."""
        if self._coding is None:
            return self.payload
        return self._coding.decode(self.payload, self.content_type, f"message #{self.seq}")

    def decode(self, codec: CodecLike) -> Any:
        """Return the payload, decoded with `codec`. Use this for a mailbox, because each sender may use another codec.

        Raises CodecError, also if the message has another content type than the codec.
        """
        coding = HandleCodec.parse(codec, "decode")
        return coding.decode(self.payload, self.content_type, f"message #{self.seq}") if coding else self.payload

    @property
    def lease_left(self) -> float:
        """The seconds for which the message is leased to this taker; 0 when the lease has ended."""
        return max(0.0, self._lease_ends_s - monotonic_s())

    async def ack(self) -> None:
        """Acknowledge the message, so that it leaves the queue. With `copies` only this taker's copy leaves the queue.

        You may repeat the call. Blocks for at most 10 s. Raises LeaseExpired if the lease has ended; another taker may
        then have the message. Raises Unavailable if the host cannot be reached.
        """
        await self._settle(queue_pb2.Settlement(acknowledge=queue_pb2.Acknowledge()))

    async def nack(self, delay: DurationLike | None = None) -> None:
        """Give the message back to its place in the queue. Any taker may get the message when `delay` has passed.

        The host delivers later messages meanwhile. Blocks for at most 10 s. Raises LeaseExpired, Unavailable.
        """
        delay_nanos = duration_of("delay", delay, least=0) or 0
        await self._settle(queue_pb2.Settlement(give_back=queue_pb2.GiveBack(delay_nanos=delay_nanos)))

    async def term(self, reason: str | None = None) -> None:
        """Give the message up for all takers.

        The message moves to the dead-letter queue of its queue. If there is none, the host deletes the message. The
        dead letter carries `reason`, at most 1024 bytes of text. Blocks for at most 10 s. Raises LeaseExpired,
        Unavailable.
        """
        await self._settle(queue_pb2.Settlement(terminate=queue_pb2.Terminate(reason=parse_reason(reason))))

    async def extend(self, lease: DurationLike = "30s") -> None:
        """Let the lease last for the time `lease` from now on, at most one hour. Blocks for at most 10 s.

        Raises LeaseExpired, Unavailable, InvalidArgument.
        """
        # None becomes 0, and the host refuses 0 with InvalidArgument.
        extension = queue_pb2.ExtendLease(lease_nanos=parse_lease(lease) or 0)
        began_s = monotonic_s()
        result = await self._send(queue_pb2.Settlement(extend_lease=extension))
        self._lease_ends_s = began_s + (result.lease_nanos or extension.lease_nanos) / 1e9

    async def _settle(self, settlement: queue_pb2.Settlement) -> None:
        await self._send(settlement)
        self._settled = True

    async def _send(self, settlement: queue_pb2.Settlement) -> queue_pb2.SettlementResult:
        settlement.delivery_id = self._delivery.delivery_id
        return await self._settler.settle(settlement, self.incarnation)

    def give_back_settlement(self) -> queue_pb2.Settlement:
        """Return the settlement that gives the message back. `max_deliveries` then does not count the delivery."""
        give_back = queue_pb2.GiveBack(uncounted=True)
        return queue_pb2.Settlement(delivery_id=self._delivery.delivery_id, give_back=give_back)

    def extend_settlement(self) -> queue_pb2.Settlement:
        """Return the settlement that renews the lease, for `lease_s` seconds from now on."""
        extension = queue_pb2.ExtendLease(lease_nanos=self._delivery.lease_nanos)
        return queue_pb2.Settlement(delivery_id=self._delivery.delivery_id, extend_lease=extension)

    def note_extended(self, result: queue_pb2.SettlementResult, began_s: float) -> bool:
        """Note the host's answer to `extend_settlement`, which the client sent at `began_s` on the monotonic clock.

        Returns whether the host has renewed the lease.
        """
        if result.HasField("error"):
            return False
        self._lease_ends_s = began_s + (result.lease_nanos or self._delivery.lease_nanos) / 1e9
        return True

    async def __aenter__(self) -> Message:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._settled:
            return
        if error is None:
            await self.ack()
            return
        try:
            await self.nack()
        except StampedeError as failure:  # the program gets the error of the block, because that error says more
            error.add_note(f"the message could not be given back; it comes again when its lease ends: {failure}")
