"""A connection to the cluster: channels, groups and queues by name, the peer's mailbox, and discovery."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any

from stampede_rt._async.channel import Channel
from stampede_rt._async.connection_host import ConnectionHost, open_channel, open_queue_near
from stampede_rt._async.cross_section import cross_section
from stampede_rt._async.directory_client import CONNECT_TIMEOUT_S
from stampede_rt._async.group import Group
from stampede_rt._async.group_channel import GroupChannel
from stampede_rt._async.group_members import GroupMembers, member_handles
from stampede_rt._async.mailbox_sender import MailboxSender
from stampede_rt._async.mailboxes import Mailboxes
from stampede_rt._async.presence import Mailbox, Presence
from stampede_rt._async.queue import Queue, dead_letter_id
from stampede_rt._async.queue_locator import queue_state
from stampede_rt._async.real_clock import RealClock
from stampede_rt._async.replay import ReplayedConnection
from stampede_rt._async.session import CALL_TIMEOUT_S, Session, request_id
from stampede_rt.cluster.embedding import START_TIMEOUT_S, InProcessHost
from stampede_rt.cluster.tracing import span
from stampede_rt.errors import InvalidArgument
from stampede_rt.handles import Reference
from stampede_rt.v1 import group_directory_service_pb2 as group_directory_pb
from stampede_rt.values.codecs import CodecLike, HandleCodec
from stampede_rt.values.grouping import (
    MAX_LEAD_DEFAULT,
    OLDEST_REFERENCE,
    CrossSection,
    GroupBound,
    Over,
    parse_group_bound,
    parse_members,
    parse_reference,
)
from stampede_rt.values.model import Ack, OnFull
from stampede_rt.values.peering import ClockOffset, PeerInfo
from stampede_rt.values.policy import parse_name, parse_policy
from stampede_rt.values.queueing import Enqueued, parse_prefetch, parse_queue_policy
from stampede_rt.values.reading import parse_replay
from stampede_rt.values.timeline import NOW, BoundLike, DurationLike, InstantLike, parse_duration
from stampede_rt.wire.groups import group_info, group_spec


class Connection(Mailboxes, RealClock, Reference):
    """A connection to a cluster, from `connect`. It opens channels, groups and queues. A context manager."""

    def __init__(self, session: Session, name: str, proof: str | None = None) -> None:
        super().__init__(session)
        if proof is not None and not name:
            raise InvalidArgument('a proof belongs to a name; give a name, too, as in name="planner"')
        self.name = name
        self._presence = Presence(session, name, proof) if name else None
        self._mailbox: Mailbox | None = None
        self._mailbox_sender = MailboxSender(session)

    def __repr__(self) -> str:
        name = f", peer {self.name!r}" if self.name else ""
        return f"<Connection to {','.join(self._session.frontends)}{name}, {self._session.state or 'open'}>"

    def __reduce__(self) -> tuple[Any, ...]:
        if self.name:
            raise TypeError(
                f"the connection of peer {self.name!r} cannot be pickled, because a name belongs to one process; pass "
                "a channel, or connect there under another name"
            )
        return self._session.reopened("connection")

    async def _open(self, host: InProcessHost | None = None) -> Connection:
        """Find the cluster, and register the peer if the connection has a name. Takes at most about 5 s.

        `host` is the channel host of this process, if there is one. It starts first, which takes at most 15 s more. As
        the host, the peer then also waits for the end of the lease of a former process with its name, for at most 15 s.
        Raises Unavailable, PermissionDenied, VersionMismatch, PeerExists, HostExists.
        """
        await self._session.open()
        if host is not None:
            await ConnectionHost(self._session, host).begin()
        if self._presence is not None:
            timeout_s = CONNECT_TIMEOUT_S if host is None else START_TIMEOUT_S
            mailbox = await self._presence.begin(timeout_s, waits_for_name=host is not None)
            self._mailbox = Mailbox(self._session, self._presence, mailbox)
        return self

    async def __aenter__(self) -> Connection:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """End all calls and streams, and deregister the peer. After that the handles of this connection no longer
        work."""
        await self._session.aclose()

    @property
    def cluster_id(self) -> str:
        """The id of the cluster."""
        return self._session.supernodes.cluster_id

    @property
    def clock(self) -> ClockOffset | None:
        """How far this machine's clock is ahead of a supernode's clock, by the last measurement.

        The client measures the offset against the nearest supernode when it connects, and from time to time when it
        calls the directory. A connection with a name also measures the offset against the leader, with each renewal of
        the peer's lease. None if no supernode has sent its time.
        """
        return self._session.supernodes.clock

    async def channel(
        self,
        name: str,
        *,
        max_age: DurationLike | None = None,
        max_items: int | None = None,
        max_bytes: int | None = None,
        consumers: int | None = None,
        on_full: OnFull | None = None,
        max_future: DurationLike | None = None,
        max_age_unconsumed: DurationLike | None = None,
        overlap: DurationLike | None = None,
        archive: DurationLike | None = None,
        archive_bytes: int | str | None = None,
        replicas: int | None = None,
        ack: Ack | None = None,
        min_replicas: int | None = None,
        content_type: str | None = None,
        codec: CodecLike | None = None,
        host: str | None = None,
        beside: Channel | str | None = None,
        create: bool = True,
    ) -> Channel:
        """Get or create a channel (paper, section 3.4 for the policies).

        If the channel exists, the call compares its policy only with the arguments that you state. A contradiction
        raises ChannelExists. A channel without a stated limit takes over arguments that nobody has stated before.
        Defaults: max_age "10s" if nobody states a limit, max_bytes 256 MiB, on_full "drop_oldest", max_future "1s".
        `consumers`: an item may leave when this number of consumers has consumed it. `max_age_unconsumed` replaces
        max_age for items that a live consumer must still consume (see `Channel.consume`): such items leave at this age.
        `overlap`: for this time after an item's own time, later items do not end its span. `archive`, such as "7d" or
        "forever", and `archive_bytes`, such as "200GiB", record the channel: its host keeps the items on disk for that
        time, and up to that size. Reads find them there. The host needs the option --archive. `replicas`, 4 at most, is
        the number of copies at other hosts. If the host is lost, one of them takes over, and lacks at most the items of
        the last second. With `ack="replica"` nothing is lost: the host acknowledges a put only when all replicas in
        sync have the item, and at least `min_replicas` (default 1) are in sync. Readers see the item only then. `host`
        names the host of a new channel. If the channel exists at another live host, the call raises ChannelExists. With
        `create=False` an absent channel raises ChannelNotFound. Blocks for at most 10 s.

        `beside` is another channel, as a handle or a name. A new channel goes to the host of that channel, unless that
        host is full or more than 95 % busy. Open the channels of a group beside each other, so that their hosts need
        not exchange times. A channel that exists stays where it is. Do not state both `host` and `beside`. If `beside`
        names a channel that does not exist, the call raises ChannelNotFound.

        `codec` belongs to the handle, not to the channel. It turns the values of `put` into payloads, and payloads into
        `item.value`: "bytes" (default), "json", "numpy" (keeps shape and dtype), or an object with `content_type`,
        `encode` and `decode`.
        """
        stated = parse_policy(
            max_age=max_age,
            max_items=max_items,
            max_bytes=max_bytes,
            consumers=consumers,
            on_full=on_full,
            max_future=max_future,
            max_age_unconsumed=max_age_unconsumed,
            overlap=overlap,
            archive=archive,
            archive_bytes=archive_bytes,
            replicas=replicas,
            ack=ack,
            min_replicas=min_replicas,
            content_type=content_type,
        )
        coding = HandleCodec.parse(codec, f"channel {parse_name(name)!r}", content_type)
        near = beside.name if isinstance(beside, Channel) else beside
        info = await open_channel(self._session, name, stated, host, create, near)
        return Channel(self._session, self._session.state_of(info, stated, create, coding))

    async def group(
        self,
        name: str,
        channels: Sequence[Channel] | None = None,
        *,
        reference: Channel | str = OLDEST_REFERENCE,
        bound: GroupBound = "start",
        idle_after: DurationLike | None = None,
        max_lead: DurationLike = MAX_LEAD_DEFAULT,
    ) -> Group:
        """Get or create a group: channels that readers see up to one common cut (paper, section 3.3).

        With only the name, the call gets an existing group and creates none.

        - `reference`: with "oldest" the group has the smallest cut of all members, with a channel the cut of that
          channel.
        - `bound`: with "start" a channel's cut is the time of its newest item. With "end" it is the end of that item's
          duration, but at most `max_lead` after the item's time.
        - `idle_after`: with reference "oldest", the group's cut does not wait for a member that has been silent for
          this duration. None: the cut waits for every member without a limit.

        Blocks for at most 10 s. Raises GroupExists if the group exists with other members or settings, GroupNotFound,
        InvalidArgument, Unavailable.
        """
        if channels is None:
            request = group_directory_pb.OpenGroupRequest(request_id=request_id(), name=parse_name(name, "group"))
        else:
            members = parse_members(channels)
            spec = group_spec(
                [member.info.channel_id for member in members],
                parse_reference(reference, members),
                parse_group_bound(bound),
                None if idle_after is None else parse_duration(idle_after, "idle_after"),
                parse_duration(max_lead, "max_lead"),
            )
            request = group_directory_pb.OpenGroupRequest(
                request_id=request_id(), name=parse_name(name, "group"), spec=spec, create=True
            )
        with span("open", group=name):
            response = await self._session.supernodes.call("OpenGroup", request, CALL_TIMEOUT_S)
        handles = member_handles(self._session, response, channels or ())
        return Group(GroupMembers(self._session, group_info(response.group), handles, create=channels is not None))

    def replay(
        self, start: InstantLike, end: InstantLike | None = None, *, speed: float = 1.0, step: bool = False
    ) -> ReplayedConnection:
        """Replay recorded channels from the instant `start` of their hosts' clocks, under a virtual clock.

        The clock moves only while the program waits: `speed` times as fast as real time; 0: without pauses. With
        `step=True` only `step` moves it. `end`: the last instant; None: the last change. Raises InvalidArgument.
        """
        return ReplayedConnection(self, self._session, *parse_replay(start, end, speed, step), step=step)

    async def cross_section(
        self,
        reference: Channel | GroupChannel,
        others: Sequence[Channel | GroupChannel],
        at: BoundLike = NOW,
        *,
        over: Over = "start",
        complete: bool = False,
        payloads: bool = True,
        timeout: float | None = 0,
        as_of: InstantLike | None = None,
    ) -> CrossSection[Channel | GroupChannel]:
        """Return one item of `reference`, and the items of every other channel at that item.

        The item of `reference` is the last of its items whose span holds `at`. `over` says which items of `others` the
        answer has: with "start" the items whose span holds the time of the reference's item, with "span" the items
        whose span shares an instant with the span of the reference's item. If `reference` has no such item,
        `section.time` is None, and the answer has only the reference.

        `timeout` in seconds bounds the whole call: 0 does not wait, None waits without a limit. The call waits for
        the first item of each channel, or with `complete` until no more items of `others` can come. `as_of` as in
        `Channel.get`.
        """
        return await cross_section(
            reference, others, at, over=over, complete=complete, payloads=payloads, timeout=timeout, as_of=as_of
        )

    async def queue(
        self,
        name: str,
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
        content_type: str | None = None,
        codec: CodecLike | None = None,
        prefetch: int = 1,
        reconnect: DurationLike | None = None,
        host: str | None = None,
        create: bool = True,
    ) -> Queue:
        """Get or create a queue (paper, section 3.5).

        If the queue exists, the call compares the stated arguments with its policy. A contradiction raises QueueExists.
        Defaults: max_bytes 256 MiB, on_full "block" (or "reject", "drop_oldest"), lease "30s", copies 1. `copies`: this
        number of distinct takers get each message. `max_deliveries`: a message leaves the queue after this number of
        deliveries without an acknowledgement. `dead_letter`: the handle or name of the queue to which such a message
        goes, and each message that a taker gives up. `replicas` (0 to 4), with `ack="replica"`: copies at other hosts,
        which get each put, delivery and acknowledgement before the caller gets its answer. One of them becomes the
        owner if the owner is lost. With fewer than `min_replicas` (default 1) in sync the queue pauses. `host`: the
        host of a new queue. If the queue does not exist and `create` is False, the call raises QueueNotFound.

        `prefetch` belongs to the handle. With 1 the handle takes a message only when a caller waits for it. With a
        greater number the handle takes up to this number of messages ahead, and extends the leases of these messages
        while callers take messages. If no caller takes a message for two thirds of a lease, the messages go back to the
        queue. `reconnect` belongs to the handle, too: after a break, a loop over the handle tries to continue for this
        duration (None: without a limit). `codec` is as in `channel`. Blocks for at most 10 s.
        """
        stated = parse_queue_policy(
            max_items=max_items,
            max_bytes=max_bytes,
            copies=copies,
            on_full=on_full,
            lease=lease,
            max_deliveries=max_deliveries,
            dead_letter_queue_id=await dead_letter_id(self._session, dead_letter, name),
            content_type=content_type,
            replicas=replicas,
            ack=ack,
            min_replicas=min_replicas,
        )
        coding = HandleCodec.parse(codec, f"queue {parse_name(name, 'queue')!r}", content_type)
        ahead = parse_prefetch(prefetch)
        info = await open_queue_near(self._session, name, stated, host, create)
        return Queue(self._session, queue_state(self._session, name, info, stated, create, coding), ahead, reconnect)

    @property
    def mailbox(self) -> Mailbox:
        """The mailbox of this connection's peer.

        Raises InvalidArgument if the connection has no name, see `connect`.
        """
        if self._mailbox is None:
            raise InvalidArgument('a mailbox belongs to a name; give a name, as in connect(name="planner")')
        return self._mailbox

    async def send(
        self,
        peer: str | PeerInfo,
        payload: Any,
        timeout: float | None = None,
        *,
        attributes: Mapping[str, str] | None = None,
        content_type: str | None = None,
        codec: CodecLike | None = None,
        message_id: str | None = None,
    ) -> Enqueued:
        """Put a message into a peer's mailbox, and return its seq there. `peer` is a name, or a PeerInfo of `peers`.

        `payload` is bytes, or a value that `codec` encodes (see `channel`). The peer then reads
        `message.decode(codec)`. A mailbox holds at most 1024 messages. `timeout` in seconds is the longest wait for
        room in a full mailbox; None waits without a limit. The client tries again after a broken connection, and the
        host never stores a message twice. `message_id` is as in `Queue.put`. Raises PeerNotFound, QueueFull,
        ItemTooLarge, CodecError, InvalidArgument; Unavailable if the mailbox's host cannot be reached.
        """
        name = peer.name if isinstance(peer, PeerInfo) else peer
        return await self._mailbox_sender.send(
            parse_name(name, "peer"), payload, timeout, attributes, content_type, codec, message_id
        )
