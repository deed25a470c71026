"""A queue's handle: first in, first out. Each message goes to one taker, or to several (paper, section 3.5)."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Any

from stampede_rt._async.attempts import Locator, attempt
from stampede_rt._async.endpoints import connection_closed
from stampede_rt._async.message import Message
from stampede_rt._async.puts import ProducerNumbers, Puts, SingleItem, enqueued
from stampede_rt._async.queue_locator import QueueLocator, QueueState, learn_queue
from stampede_rt._async.session import CALL_TIMEOUT_S, Session, left_s, request_id
from stampede_rt._async.stream_reconnector import StreamReconnector
from stampede_rt._async.taker import Taker
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.request_age import age_clock_s
from stampede_rt.cluster.tracing import span
from stampede_rt.errors import InvalidArgument
from stampede_rt.handles import Reference, handle_repr
from stampede_rt.transports.concurrency_async import monotonic_s, when_dropped
from stampede_rt.transports.grpc_async import ServerEndpoint
from stampede_rt.v1 import queue_directory_service_pb2 as queue_directory_pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.values.model import Ack, OnFull
from stampede_rt.values.policy import count_of, parse_name
from stampede_rt.values.queueing import Enqueued, PendingMessage, QueueInfo, QueuePolicy, QueueStats, parse_queue_policy
from stampede_rt.values.reading import Wait
from stampede_rt.values.timeline import DurationLike
from stampede_rt.wire.queues import pending_message, queue_policy_to_spec, queue_stats

PENDING_PAGE_MAX = 1000


class TakingHandle:
    """A handle that takes messages from a queue, or from the connection's own mailbox.

    A loop over the handle waits for each message without a limit. Any number of threads or tasks may take messages.
    """

    def __init__(
        self,
        session: Session,
        state: QueueState,
        locator: Locator,
        prefetch: int,
        reconnect: DurationLike | None = None,
    ) -> None:
        self._session = session
        self._reconnecting = StreamReconnector(
            session, f"the iteration over {state.kind} {state.name!r}", reconnect, held=True
        )
        self._state = state
        self._locator = locator
        self._taker = Taker(session, locator, state, prefetch, session.supernodes.peer_name)
        when_dropped(self, self._taker.let_go)

    @property
    def name(self) -> str:
        """The name of the queue. A mailbox has the name of its peer."""
        return self._state.name

    @property
    def info(self) -> QueueInfo:
        """The directory's description of the queue, as last known."""
        return self._state.info

    @property
    def host(self) -> str:
        """The name of the host that owns the queue, as last known."""
        return self._state.info.host

    @property
    def incarnation(self) -> int:
        """The queue's incarnation, as last known. If it changes, messages may have been lost."""
        return self._state.info.incarnation

    def __repr__(self) -> str:
        state = self._session.state or ("closed" if self._taker.closed else "")
        return handle_repr(type(self).__name__, self.name, self.info.queue_id, self.host, state)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other._state.info.queue_id == self._state.info.queue_id

    def __hash__(self) -> int:
        return hash(self._state.info.queue_id)

    async def get(self, timeout: float | None = None) -> Message | None:
        """Return the next message, or None after `timeout`. The message is leased to this handle.

        `timeout` in seconds: 0 takes only a message that the host can deliver immediately, None waits without a limit.
        The host serves the taker that has waited longest. Raises QueueNotFound; Unavailable if the host cannot be
        reached for 10 s; InvalidArgument if this handle is closed.
        """
        with span("take", queue=self.name):
            return await self._taker.get(Wait.parse(timeout))

    def __aiter__(self) -> TakingHandle:
        return self

    async def __anext__(self) -> Message:
        if self._taker.closed:
            if self._session.closing:
                raise connection_closed()
            raise StopAsyncIteration
        found: list[Message | None] = []

        async def take(timeout_s: float) -> None:
            found.append(await self.get())

        await self._reconnecting.open(take)
        if not found or found[0] is None:  # the program called `aclose` meanwhile
            raise StopAsyncIteration
        return found[0]

    @property
    def reconnects(self) -> int:
        """The number of times that the loop over this handle continued after a break of 10 s or more."""
        return self._reconnecting.reconnects

    @property
    def connected(self) -> bool:
        """Whether the loop over this handle reaches the host, as last known. False when the handle is closed."""
        return self._reconnecting.connected and not self._taker.closed

    async def stats(self) -> QueueStats:
        """Return the queue's counters at one moment. Blocks for at most 10 s. Raises QueueNotFound, Unavailable."""
        return await stats_at(self._session, self._locator)

    async def pending(self, limit: int = 1000) -> list[PendingMessage]:
        """List the leased messages, at most `limit`, in the order of their deliveries.

        Each entry names the taker and the beginning and end of the lease. The client fetches a long list page by page.
        A message that its taker settles meanwhile may be missing. Raises QueueNotFound, Unavailable, InvalidArgument.
        """
        return await pending_at(self._session, self._locator, limit)

    async def configure(
        self,
        *,
        max_items: int | None = None,
        max_bytes: int | None = None,
        copies: int | None = None,
        on_full: OnFull | None = None,
        lease: DurationLike | None = None,
        max_deliveries: int | None = None,
        dead_letter: Queue | str | None = None,
        replicas: int | None = None,
        ack: Ack | None = None,
        min_replicas: int | None = None,
    ) -> QueuePolicy:
        """Change the queue's policy while it runs, and return the new policy.

        A setting that you leave out stays as it is. Blocks for at most 40 s. Raises InvalidArgument, QueueNotFound,
        Unavailable.
        """
        policy = parse_queue_policy(
            max_items=max_items,
            max_bytes=max_bytes,
            copies=copies,
            on_full=on_full,
            lease=lease,
            max_deliveries=max_deliveries,
            dead_letter_queue_id=await dead_letter_id(self._session, dead_letter, self.info.name),
            replicas=replicas,
            ack=ack,
            min_replicas=min_replicas,
        )
        return await self._update(policy)

    async def _update(self, policy: QueuePolicy) -> QueuePolicy:
        identity, since_s = request_id(), age_clock_s()

        async def update_at(binding: Binding, timeout_s: float) -> QueuePolicy:
            request = queue_directory_pb.UpdateQueueRequest(
                request_id=identity,
                queue_id=binding.subject_id,
                epoch=binding.epoch,
                spec=queue_policy_to_spec(policy),
            )
            deadline_s = monotonic_s() + timeout_s
            response = await self._session.supernodes.call("UpdateQueue", request, timeout_s, since_s=since_s)
            request_now = queue_directory_pb.ResolveQueueRequest(queue_id=binding.subject_id)
            now = await self._session.supernodes.call("ResolveQueue", request_now, left_s(deadline_s))
            self._state.info = learn_queue(self._session, response.queue, now.host)
            return self._state.info.policy

        return await attempt(self._locator, update_at, CALL_TIMEOUT_S)

    async def aclose(self) -> None:
        """Stop taking: waiting calls return None, and prefetched messages go back to the queue.

        Messages that callers have received stay leased, and the callers may still settle these messages. When the
        connection closes, it closes this handle, too.
        """
        self._reconnecting.stop()
        await self._taker.end()


class Queue(TakingHandle, Reference):
    """A named queue. Handles of one queue are equal. Any number of handles may put and take, in any process.

    A handle is also a context manager: the end of the block calls `aclose`. The host delivers messages in the order in
    which it accepted them, each at least once. It leases a message to one taker at a time, or with `copies` to several.
    If a taker does not acknowledge a message before the lease ends, the host delivers the message again.
    """

    def __init__(
        self, session: Session, state: QueueState, prefetch: int, reconnect: DurationLike | None = None
    ) -> None:
        locator = QueueLocator(session, state)
        self._reconnect = reconnect
        super().__init__(session, state, locator, prefetch, reconnect)
        self._puts = Puts(session, locator, ServerEndpoint.enqueues)
        self._numbers = ProducerNumbers()

    def __reduce__(self) -> tuple[Any, ...]:
        state = self._state
        return self._session.reopened(
            "queue", self.name, state.stated, state.create, state.coding, self._taker.prefetch, self._reconnect
        )

    async def __aenter__(self) -> Queue:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.aclose()

    async def put(
        self,
        payload: Any,
        timeout: float | None = None,
        *,
        attributes: Mapping[str, str] | None = None,
        content_type: str | None = None,
        message_id: str | None = None,
    ) -> Enqueued:
        """Put one message, wait until the host has accepted it, and return its seq and incarnation.

        `payload` is bytes, or a value if the handle has a codec. `timeout` in seconds is the longest wait for room in a
        full queue with on_full="block" (the default); None waits without a limit. The client tries again after a broken
        connection, and the host never stores a message twice. With a `message_id` (1 to 128 bytes) the host also
        recognises a second put of the same id by any program. The second put returns the seq of the first one, and its
        `duplicate` is True. The host remembers an id for 10 minutes. It forgets an id earlier if the ids of the queue
        take more than 16 MiB, or if the host ends. Puts that are under way at the same time may arrive in any order. If
        their order matters, wait for the end of each put before you begin the next one. Raises QueueFull, ItemTooLarge,
        CodecError, QueueNotFound; Unavailable if the host cannot be reached.
        """
        item = SingleItem.parse(self._state.coding, payload, None, None, attributes, content_type, message_id)
        with span("enqueue", queue=self.name):
            return enqueued(await self._puts.put(self._numbers.put_of(item), Wait.parse(timeout)))

    async def delete(self) -> None:
        """Delete the queue with all its messages, for everyone. Blocks for at most 10 s.

        Raises InvalidArgument if the queue is the dead-letter queue of another queue; QueueNotFound, Unavailable.
        """
        request = queue_directory_pb.DeleteQueueRequest(request_id=request_id(), queue_id=self.info.queue_id)
        await self._session.supernodes.call("DeleteQueue", request, CALL_TIMEOUT_S)
        await self.aclose()
        self._puts.close()
        self._session.cache.forget(self.info.queue_id)


async def stats_at(session: Session, locator: Locator) -> QueueStats:
    """Return the counters of the queue that `locator` finds."""

    async def status_at(binding: Binding, timeout_s: float) -> QueueStats:
        endpoint = session.endpoints.to(binding.target)
        request = queue_pb.GetQueueStatusRequest(queue_id=binding.subject_id, epoch=binding.epoch)
        response = await endpoint.call(endpoint.queues.GetQueueStatus, request, timeout_s)
        return queue_stats(response.status)

    return await attempt(locator, status_at, CALL_TIMEOUT_S)


async def pending_at(session: Session, locator: Locator, limit: int) -> list[PendingMessage]:
    """Return the leased messages of the queue that `locator` finds, at most `limit`, in the order of their deliveries.

    If the queue moves to another host meanwhile, reads the list again from its beginning.
    """
    messages_max = count_of("limit", limit) or 1

    async def pages_at(binding: Binding, timeout_s: float) -> list[PendingMessage]:
        endpoint, deadline_s = session.endpoints.to(binding.target), monotonic_s() + timeout_s
        found: list[PendingMessage] = []
        after, more = 0, True
        while more and len(found) < messages_max:  # a page begins after the last delivery of the page before
            request = queue_pb.ListPendingRequest(
                queue_id=binding.subject_id,
                epoch=binding.epoch,
                after_delivery_id=after,
                page_size=min(messages_max - len(found), PENDING_PAGE_MAX),
            )
            page = await endpoint.call(endpoint.queues.ListPending, request, left_s(deadline_s))
            found += map(pending_message, page.deliveries)
            after, more = page.deliveries[-1].delivery_id if page.deliveries else after, page.more
        return found

    return await attempt(locator, pages_at, CALL_TIMEOUT_S)


async def dead_letter_id(session: Session, queue: Queue | str | None, of: str) -> bytes | None:
    """Return the id of `queue`, the dead-letter queue of the queue named `of`; None if `queue` is None.

    `queue` is a handle or a name. Raises QueueNotFound; InvalidArgument if `queue` is the queue `of` itself.
    """
    if queue is None:
        return None
    if of and of == (queue.info.name if isinstance(queue, Queue) else queue):
        raise InvalidArgument(
            f"dead_letter is queue {of!r} itself, so its dead letters would come back to it; name another queue"
        )
    if isinstance(queue, Queue):
        return queue.info.queue_id
    request = queue_directory_pb.ResolveQueueRequest(name=parse_name(queue, "dead-letter queue"))
    response = await session.supernodes.call("ResolveQueue", request, CALL_TIMEOUT_S)
    return bytes(response.queue.queue_id)
