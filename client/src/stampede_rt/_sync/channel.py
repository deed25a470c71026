# Generated from ../_async by tools/generate.py; do not edit.
"""A channel's handle: puts, reads by time, subscriptions (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from time import time_ns
from typing import Any

from stampede_rt._sync.calls_here import put_here
from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.consuming import consume
from stampede_rt._sync.producer import Producer
from stampede_rt._sync.puts import ProducerNumbers, Puts, SingleItem
from stampede_rt._sync.reader import Reader
from stampede_rt._sync.sampler import MonotonicClock, Sampler
from stampede_rt._sync.session import CALL_TIMEOUT_S, TRY_TIMEOUT_S, ChannelLocator, Session, request_id
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.request_age import age_clock_s
from stampede_rt.cluster.tracing import span
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import DeadlineExceeded, InvalidArgument, Unavailable
from stampede_rt.transports.concurrency_sync import monotonic_s
from stampede_rt.transports.grpc_sync import ServerEndpoint
from stampede_rt.transports.ring_mapping import boottime_nanos
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import directory_service_pb2, gatekeeper_service_pb2
from stampede_rt.values.model import Ack, Item, OnFull, Policy
from stampede_rt.values.policy import parse_policy
from stampede_rt.values.reading import NO_WAIT, RENEW_S, Wait
from stampede_rt.values.statistics import ChannelStats
from stampede_rt.values.timeline import DurationLike, InstantLike, parse_duration, parse_instant
from stampede_rt.wire.records import channel_info, channel_stats, policy_to_spec, with_users

PERIOD_NANOS_MIN = 1_000_000  # the shortest period of `sample`
# The first wait for room that a put asks for, if the handle knows a policy without on_full="block".
# Under that policy no put waits. But another program may have set "block" since the handle learned the policy.
FIRST_WAIT_S = 1.0
DROP_TRIES_S = 1.0  # the client begins no further try after this time, and asks the directory


class Channel(Reader):
    """A named, time-indexed live stream. Handles of one channel are equal. Any process may have any number of them."""

    def __init__(self, session: Session, state: ChannelState) -> None:
        super().__init__(session, state)
        self._puts = Puts(session, ChannelLocator(session, state), ServerEndpoint.puts)
        self._numbers = ProducerNumbers()

    def __reduce__(self) -> tuple[Any, ...]:
        return self._session.reopened("channel", self.name, self._state.stated, self._state.create, self._state.coding)

    def put(
        self,
        payload: Any,
        *,
        time: InstantLike | None = None,
        duration: DurationLike | int | None = None,
        attributes: Mapping[str, str] | None = None,
        content_type: str | None = None,
        ack: Ack | None = None,
        timeout: float | None = None,
    ) -> Item:
        """Put one item, wait until the host has accepted it, and return it with its `time` and `seq`.

        `payload` is bytes, or a value if the handle has a codec. `time` is an instant; without it the host stamps the
        item with the time at which it accepts the item. `duration` is text such as "33ms", a timedelta, or int
        nanoseconds. `ack` says when the host acknowledges this put: "host", "disk" (it is on stable storage) or
        "replica"; without it the channel's policy decides. `timeout` in seconds is the longest wait for room on a full
        channel with on_full="block"; None waits without a limit. With ack="replica" or "disk", `timeout` also bounds
        the wait for the replicas or the disk. The client tries again after a broken connection, and the host never
        stores an item twice. Puts that are under way at the same time may arrive in any order. If their order matters,
        wait for the end of each put before you begin the next one. Raises TooOld, InFuture, ChannelFull, ItemTooLarge,
        CodecError; NotReplicated if the replicas did not have the item in time, though the channel has accepted it;
        NotArchived if the disk did not take the item; InvalidArgument if the channel cannot give such an `ack`;
        Unavailable if the host cannot be reached.
        """
        item = SingleItem.parse(self._state.coding, payload, time, duration, attributes, content_type, ack=ack)
        on_full = self.info.policy.on_full
        renew_s = RENEW_S if on_full == "block" else FIRST_WAIT_S
        ack_of_put, fills = ack or self.info.policy.ack or "host", on_full in ("block", "reject")
        may_fill = fills or ack_of_put != "host"
        with span("put", channel=self.name):
            wait, put, accepted = Wait.parse(timeout), self._numbers.put_of(item), None
            if self._session.here is not None and not fills and ack_of_put != "replica":
                began_s = monotonic_s()
                disk_wait = wait if ack_of_put == "disk" else NO_WAIT
                accepted = put_here(self._session, self._state, put, ack, disk_wait)
                wait = wait.after(monotonic_s() - began_s)
            if accepted is None:  # if the host of this process has put the item after all, it recognises the number
                accepted = self._puts.put(put, wait, renew_s, may_fill=may_fill)
        return item.accepted_as(self._state, accepted)

    def producer(self, ack: Ack | None = None) -> Producer:
        """Return a context manager for many puts. These puts do not wait for their acknowledgements.

        `ack` says when the host acknowledges them, as for `put`.
        """
        return Producer(self._session, self._state, ack)

    def sample(self, fn: Callable[[], Any], every: DurationLike = "33ms") -> Sampler:
        """Call `fn` once in each period and put its result, until `cancel` of the returned handle.

        Period k begins k times `every` after this call, so delays do not add up. If `fn` or a put takes so long that a
        whole period passes, the handle skips that period and counts it. If `fn` returns None, the handle puts nothing.
        The handle logs and counts an exception of `fn` or of the put, and continues with the next period. On a full
        channel with on_full="block" a put waits for at most one period. Raises InvalidArgument.
        """
        every_nanos = parse_duration(every, "every")
        if every_nanos < PERIOD_NANOS_MIN:
            raise InvalidArgument(f'every is {every!r}; it must be 1 ms or more, as in every="33ms"')

        def put(value: Any, timeout_s: float) -> None:
            self.put(value, timeout=timeout_s)

        return Sampler(self._session, f"channel {self.name!r}", put, fn, every_nanos, MonotonicClock())

    def consume(self, items: Item | Iterable[Item]) -> int:
        """Consume items of a channel with `consumers` or `max_age_unconsumed`.

        Returns the number of items that this consumer had not consumed before.

        An item leaves the channel when all consumers have consumed it and all older items. Until then every reader sees
        the item. The consumer is this connection: all handles of the channel in this connection count as one consumer.
        The first call takes one of the channel's consumer places. `consume([])` takes a place and consumes nothing. The
        library keeps the place until the connection is closed. A process that dies loses its place within 10 s. The
        channel keeps all items for a place that no consumer has taken yet. A consumer that takes the place of a lost
        consumer starts at the newest item. You may repeat the call; the client also tries again by itself. Raises
        ChannelFull if all places are taken, InvalidArgument if the channel has no consumer places, IncarnationLost if
        the channel's host was lost after the program had read the items.
        """
        return consume(self._session, self._state, items)

    def advance(self, time: InstantLike) -> int:
        """Promise that no item earlier than `time` will come. From then on the host refuses earlier items.

        Returns the latest instant that any producer has promised so far, in nanoseconds. Blocks for at most 10 s.
        Raises InFuture, ChannelNotFound, Unavailable.
        """
        instant = parse_instant(time)

        def advance_at(binding: Binding, timeout_s: float) -> int:
            endpoint = self._session.endpoints.to(binding.target)
            request = channel_pb.AdvanceRequest(
                channel_id=binding.subject_id, epoch=binding.epoch, time_unix_nano=instant
            )
            response = endpoint.call(endpoint.channels.Advance, request, timeout_s)
            return int(response.advance_unix_nano)

        return self._session.perform(self._state, advance_at)

    def stats(self) -> ChannelStats:
        """Return the channel's counters and bounds at one moment, the offset of the host's clock, and the transport.

        The offset says how far the host's clock is ahead of this machine's clock. Blocks for at most 10 s. Raises
        ChannelNotFound, Unavailable.
        """
        return self._stats_within(CALL_TIMEOUT_S)

    def _stats_within(self, timeout_s: float) -> ChannelStats:
        """Return the same as `stats`. Blocks for about `timeout_s` seconds at most."""

        def status_at(binding: Binding, timeout_s: float) -> ChannelStats:
            endpoint = self._session.endpoints.to(binding.target)
            request = channel_pb.GetChannelStatusRequest(channel_id=binding.subject_id, epoch=binding.epoch)
            sent_s, sent = monotonic_s(), time_ns()
            response = endpoint.call(endpoint.channels.GetChannelStatus, request, timeout_s)
            asked_at = sent + round((monotonic_s() - sent_s) / 2 * 1e9)
            stats = channel_stats(
                response.status,
                clock_offset_nanos=response.status.host_time_unix_nano - asked_at,
                transport=self._transport(endpoint),
            )
            return with_users(stats, response)

        return self._session.perform(self._state, status_at, timeout_s)

    def _transport(self, endpoint: ServerEndpoint) -> str:
        """Return the transport of reads of the newest items."""
        mapping = self._session.rings.find(self._state)
        if mapping is not None and mapping.is_open(boottime_nanos()):
            return Transport.SHARED.value
        return endpoint.transport()

    def configure(
        self,
        *,
        max_age: DurationLike | None = None,
        max_items: int | None = None,
        max_bytes: int | None = None,
        consumers: int | None = None,
        on_full: OnFull | None = None,
        max_future: DurationLike | None = None,
        max_age_unconsumed: DurationLike | None = None,
        archive: DurationLike | None = None,
        archive_bytes: int | str | None = None,
        replicas: int | None = None,
        ack: Ack | None = None,
        min_replicas: int | None = None,
    ) -> Policy:
        """Change the channel's policy while it runs, and return the policy after the change.

        A setting that you leave out stays as it is. With more `consumers` the channel gets new consumer places, which
        keep all held items. With fewer `consumers`, the channel removes the places whose leases end first. `archive`
        and `archive_bytes` record the channel from now on, or change the limits of its archive. `replicas=0` takes the
        replicas away; if puts wait for replicas, also state `ack="host"`. Blocks for at most 10 s. Raises
        InvalidArgument, ChannelNotFound, Unavailable.
        """
        policy = parse_policy(
            max_age=max_age,
            max_items=max_items,
            max_bytes=max_bytes,
            consumers=consumers,
            on_full=on_full,
            max_future=max_future,
            max_age_unconsumed=max_age_unconsumed,
            archive=archive,
            archive_bytes=archive_bytes,
            replicas=replicas,
            ack=ack,
            min_replicas=min_replicas,
        )
        return self._set_policy(policy)

    def _set_policy(self, policy: Policy) -> Policy:
        """Change the stated settings of the policy, and return the whole policy."""
        identity, since_s = request_id(), age_clock_s()

        def configure_at(binding: Binding, timeout_s: float) -> Policy:
            endpoint = self._session.endpoints.to(binding.target)
            request = gatekeeper_service_pb2.ConfigureChannelRequest(
                request_id=identity,
                channel_id=binding.subject_id,
                epoch=binding.epoch,
                spec=policy_to_spec(policy),
            )
            age_s = age_clock_s() - since_s
            response = endpoint.call(endpoint.gatekeeper.ConfigureChannel, request, timeout_s, age_s=age_s)
            return channel_info(response.channel, None).policy

        return self._session.perform(self._state, configure_at)

    def delete(self) -> None:
        """Delete the channel and all its items, for everyone. This also works if the channel's host is lost.

        Blocks for at most 16 s. Raises ChannelNotFound, Unavailable.
        """
        identity, since_s = request_id(), age_clock_s()

        def drop_at(binding: Binding, _: float) -> None:
            endpoint = self._session.endpoints.to(binding.target)
            request = gatekeeper_service_pb2.DropChannelRequest(
                request_id=identity, channel_id=binding.subject_id, epoch=binding.epoch
            )
            endpoint.call(endpoint.gatekeeper.DropChannel, request, TRY_TIMEOUT_S, age_s=age_clock_s() - since_s)

        try:
            self._session.perform(self._state, drop_at, DROP_TRIES_S)
        except (Unavailable, DeadlineExceeded):
            # The host cannot be reached. The directory deletes the channel nevertheless.
            request = directory_service_pb2.DeleteChannelRequest(
                request_id=identity, channel_id=self._state.info.channel_id
            )
            self._session.supernodes.call("DeleteChannel", request, CALL_TIMEOUT_S, since_s=since_s)
        self._puts.close()
        self._session.cache.forget(self._state.info.channel_id)
