"""The counters of a channel, as callers get them. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from stampede_rt.values.model import Policy
from stampede_rt.values.proxying import CopyStats


@dataclass(frozen=True, kw_only=True, slots=True)
class ConsumerStats:
    """A consumer place of a channel.

    `waiting` is the number of held items that the consumer must still consume. `lease_nanos` is the rest of the place's
    lease. If it is 0, the lease has ended, and the place holds back no item until a consumer takes the place.
    """

    consumer_id: int
    lease_nanos: int
    waiting: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ReaderStats:
    """An open subscription to a channel.

    `subscriber`: the caller's verified name, or "@" and the caller's address; then "#" and a number of the
    subscription. `collected` counts the items that left the channel before the reader took them. `skipped` counts the
    items that a reader of the newest item did not take, because a newer item came.
    """

    subscriber: str
    collected: int
    skipped: int


@dataclass(frozen=True, kw_only=True, slots=True)
class WriterStats:
    """A caller whose items a channel accepted.

    `name`: the caller's verified name, or "@" and the caller's address. `last_put`: the time of the caller's last
    accepted put, in nanoseconds since the epoch, by the host's clock.
    """

    name: str
    last_put: int


@dataclass(frozen=True, kw_only=True, slots=True)
class MulticastStats:
    """How a subscription with `via="multicast"` gets its items. The counts begin with the subscription.

    `following`: the items come from datagrams now; False: the host sends them only to this reader. `group`: the
    multicast group and port, "ADDRESS:PORT"; empty before the host has named it. `datagrams`: the opened datagrams.
    `items`: the items that came in them. `repairs`: the requests for items that no datagram brought. `repeated`: the
    datagrams and messages that brought nothing new. The reader dropped the other datagrams. `forged`: datagrams whose
    sender did not have the key, or was not the host. `foreign`: datagrams of other channels and programs. `other_key`:
    datagrams that are encrypted with a key that the reader does not have.
    """

    following: bool = False
    group: str = ""
    datagrams: int = 0
    items: int = 0
    repairs: int = 0
    repeated: int = 0
    forged: int = 0
    foreign: int = 0
    other_key: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelMulticastStats:
    """How a host multicasts a channel at the moment. The counts begin with the first reader.

    `group`: the multicast group and port, "ADDRESS:PORT". `readers`: the open subscriptions with `via="multicast"`.
    `datagrams`: the sent datagrams. `bytes`: their bytes, without the headers of UDP and IP. `repairs`: the requests of
    readers for items that no datagram brought them.
    """

    group: str
    readers: int
    datagrams: int
    bytes: int
    repairs: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ArchiveStats:
    """The archive of a recorded channel at one moment.

    - `items` and `bytes` count everything in the archive, `disk_bytes` the part on the host's disk. The other bytes are
      in an object store.
    - `oldest` and `newest` are the least and the greatest time of the archived items; None if there is no item.
    - `waiting`: the accepted items that are not on the disk yet. `unarchived`: the items that `max_bytes` collected
      before they were on the disk, since the host opened the channel. The archive will never have these.
    - `place`: the host's folder, or the URL of the object store and the folder.
    - `failure`: why the last write, or the last call of the object store, failed; empty if it succeeded.

    While the object store is unreachable, a host may not know all files in it. The numbers then lack these files.
    """

    items: int
    bytes: int
    disk_bytes: int
    oldest: int | None
    newest: int | None
    waiting: int
    unarchived: int
    place: str
    failure: str


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelStats:
    """A channel's counters at one moment: `accepted == held + sum(collected.values())`, always.

    - `collected` counts the collected items by cause: age, count, bytes, consumption. `rejected` counts the refused
      items by reason.
    - `newest` and `oldest` are the times of the newest and the oldest held item, `frontier` is the latest end of the
      spans of collected items, and `advance` the highest advance. Each is None if there is no such item or advance.
      Items that only the archive of a recorded channel has count as collected here.
    - `consumers` lists the taken places; `policy.consumers` counts all places.
    - `clock_offset_nanos`: how far the host's clock is ahead of this machine's clock. The error is at most half the
      round trip of the call. The offset is None in a list of channels.
    - `transport`: how this program reaches the channel's data: "grpc", "socket" (a Unix socket), "tcp", or "shared"
      while reads of the newest items need no call; None in a list of channels.
    - `subscriptions` and `waiting_gets` do not count readers that follow the channel in shared memory.
    - `copies`: the copies that the host feeds: proxies and replicas.
    - `replicated`: all items with a smaller seq are replicated, so that readers see them; None without replicas.
      `not_replicated`: the accepted items of puts that ended with NotReplicated.
    - `inherited_next_seq`: the owner was lost, and this incarnation began with the items of a replica: the items with a
      smaller seq. Later items of the former incarnation are lost. None: this incarnation began without items.
    - `dropped`: the items that the open subscriptions did not get, because their readers were too slow.
    - `multicast`: how the host multicasts the channel; None if no reader subscribes with `via="multicast"`.
    - `readers`: at most 64 open subscriptions at the channel's host, the slowest first. `writers`: the latest writers,
      at most 8, the latest first. Both are None without the right to read the channel, and in a list of channels.
    - `archive`: the archive of the channel at its host; None if the channel is not recorded.
    - `next_seq`: the seq that the next accepted item gets; None if the host is of an earlier release.
    - `has_lost_items`: whether items were lost with a former host; None if the host is of an earlier release.
    """

    accepted: int
    held: int
    collected: Mapping[str, int]
    rejected: Mapping[str, int]
    accepted_bytes: int
    held_bytes: int
    delivered_bytes: int
    newest: int | None
    oldest: int | None
    frontier: int | None
    advance: int | None
    subscriptions: int
    waiting_gets: int
    waiting_puts: int
    incarnation: int
    host_time: int
    policy: Policy = field(default_factory=Policy)
    consumers: Sequence[ConsumerStats] = ()
    clock_offset_nanos: int | None = None
    transport: str | None = None
    copies: Sequence[CopyStats] = ()
    replicated: int | None = None
    not_replicated: int = 0
    inherited_next_seq: int | None = None
    dropped: int = 0
    multicast: ChannelMulticastStats | None = None
    readers: Sequence[ReaderStats] | None = None
    writers: Sequence[WriterStats] | None = None
    archive: ArchiveStats | None = None
    next_seq: int | None = None
    has_lost_items: bool | None = None
