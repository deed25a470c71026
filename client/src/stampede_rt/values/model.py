"""The values that callers get: items, answers, descriptions of channels and hosts. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

REPR_BYTES_MAX = 32  # the payload bytes that the `repr` of an item shows
MAX_AGE_DEFAULT_NANOS = 10_000_000_000
OVERLAP_NANOS_MAX = 3_600_000_000_000
"""The greatest `Policy.overlap_nanos`, one hour. A read must also look at the items in the time `overlap_nanos` before
its start."""

OnFull = Literal["drop_oldest", "block", "reject"]
"""The effect of a put on a full channel or queue."""
Ack = Literal["host", "disk", "replica"]
"""When the host acknowledges a put: when it has the item, when its disk has it, or when the replicas have it, too."""
ChangeKind = Literal["added", "updated", "removed"]


class Item(NamedTuple):
    """One item of a channel (paper, section 3.2). Times are nanoseconds since the epoch, durations are nanoseconds.

    - `end` is the end of the item's span at the time of the read: the earlier of time + duration and the time of the
      next later item. In a channel with `overlap`, a later item cannot end the span of an item with a duration earlier
      than time + `overlap`. `end` is None for an item without a duration and without a later item.
    - `seq` grows by one for each item that the channel accepts, within one `incarnation` of the channel.
    - `payload` is None in reads without payloads; `payload_length_bytes` is the length even then.
    """

    time: int
    end: int | None
    duration: int | None
    seq: int
    payload: bytes | None
    attributes: Mapping[str, str]
    content_type: str
    payload_length_bytes: int
    incarnation: int

    @property
    def value(self) -> Any:
        """The payload as the handle's codec decodes it, or the payload itself without a codec."""
        return self.payload

    @property
    def copies(self) -> int | None:
        """For an item that `put` returned: the number of hosts that hold the item, and can own the channel.

        The present owner is one of them: without replicas the number is 1. None for an item that was read.
        """
        return None

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Item) and tuple(self) == tuple(other))

    def __hash__(self) -> int:
        return hash((self.time, self.seq, self.incarnation))

    def __repr__(self) -> str:
        shown = self.payload
        if shown is not None and len(shown) > REPR_BYTES_MAX:
            payload = f"{shown[:REPR_BYTES_MAX]!r}... ({len(shown)} bytes)"
        else:
            payload = repr(shown)
        extra = f", attributes={dict(self.attributes)}" if self.attributes else ""
        kind = f", content_type={self.content_type!r}" if self.content_type else ""
        return f"Item(time={self.time}, seq={self.seq}, duration={self.duration}, payload={payload}{extra}{kind})"


class PutItem(Item):
    """An item that `put` returned."""

    acknowledged_copies: int | None = None

    @property
    def copies(self) -> int | None:
        """See `Item.copies`."""
        return self.acknowledged_copies


class Reason(str):
    """The reason why an answer is empty or partial. It compares as a string; `detail` explains it in a sentence.

    `before`: with LOST, the items that `detail` speaks of have times before this instant; None: not known.
    """

    COLLECTED: Reason  # retention has collected the items
    NEVER: Reason  # no item was put there, and none can come
    NOT_YET: Reason  # no item has come yet
    HIDDEN: Reason  # there are items, but they are not before the cut of the group
    LOST: Reason  # the items were lost with their host
    detail: str
    before: int | None

    def __new__(cls, value: str, detail: str = "", before: int | None = None) -> Reason:
        """A reason with its explanation."""
        self = super().__new__(cls, value)
        self.detail = detail
        self.before = before
        return self

    @property
    def value(self) -> str:
        """The plain string."""
        return str(self)


for _name in ("COLLECTED", "NEVER", "NOT_YET", "HIDDEN", "LOST"):
    setattr(Reason, _name, Reason(_name))


@dataclass(frozen=True, kw_only=True, slots=True)
class Policy:
    """The policy of a channel (paper, section 3.4). None: the setting was not stated.

    `max_age_unconsumed_nanos` replaces `max_age_nanos` for items that a live consumer must still consume.
    `overlap_nanos`: for this time after an item's own time, later items do not end the span of an item with a duration.
    If it is None, the next later item always ends the span. With `archive_nanos` or `archive_bytes` the channel is
    recorded: its host keeps the items in an archive, for that time and up to that many bytes. `replicas` is the number
    of copies that can become the owner. `ack`: the host acknowledges a put when it has the item ("host"), when its disk
    has it ("disk"), or when the replicas have it ("replica"). `min_replicas`: with fewer replicas in sync the host
    acknowledges no put.
    """

    max_age_nanos: int | None = None
    max_items: int | None = None
    max_bytes: int | None = None
    consumers: int | None = None
    on_full: OnFull | None = None
    max_future_nanos: int | None = None
    content_type: str | None = None
    max_item_bytes: int | None = None
    max_age_unconsumed_nanos: int | None = None
    overlap_nanos: int | None = None
    archive_nanos: int | None = None
    archive_bytes: int | None = None
    replicas: int | None = None
    ack: Ack | None = None
    min_replicas: int | None = None

    @property
    def effective_max_age_nanos(self) -> int | None:
        """The limit of age: the default if the policy states none of `max_age_nanos`, `max_items`, `max_bytes` and
        `consumers`.
        """
        stated = (self.max_age_nanos, self.max_items, self.max_bytes, self.consumers)
        return MAX_AGE_DEFAULT_NANOS if all(one is None for one in stated) else self.max_age_nanos

    @property
    def is_recorded(self) -> bool:
        """Whether the host keeps the items in an archive."""
        return self.archive_nanos is not None or self.archive_bytes is not None


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelInfo:
    """A channel as the directory knows it.

    `created_by` is the caller that created the channel, by the name that rules of access use: the name in the caller's
    certificate or token, or "@clients" or "@cluster" for a caller that has only a secret. It is empty if not known.
    `spec_version` rises with each change of the policy.
    """

    channel_id: bytes
    name: str
    host_id: bytes
    host: str
    host_alive: bool
    epoch: int
    incarnation: int
    policy: Policy
    spec_version: int
    created_by: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class LoadInfo:
    """The load that a host reported, as the directory last noted it, perhaps a few seconds ago or earlier.

    - `busy_permille` is the share of one core that the host's process used, in thousandths.
    - `held_bytes` are the bytes of its channels and queues, of at most `bytes_max`; 0 if the host has not reported
      them.
    - `private`: the directory places nothing there unless a caller names the host.
    """

    busy_permille: int
    held_bytes: int
    bytes_max: int
    private: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class HostInfo:
    """A channel host as the directory knows it.

    `load` is None if the directory knows no load. `lease_ended` is the time, in Unix nanoseconds, at which the
    directory ended the lease of a host that did not renew it; None if the host lives or has deregistered.
    `archive_place` is the folder of its archive, or the URL of an object store and a folder; None if the host has no
    archive.
    """

    host_id: bytes
    name: str
    endpoints: Sequence[str]
    alive: bool
    channels: int
    version: str
    load: LoadInfo | None = None
    lease_ended: int | None = None
    archive_place: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class SupernodeInfo:
    """A supernode, from the view of the supernode that answered the call."""

    supernode_id: str
    endpoint: str
    is_leader: bool
    healthy: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """One change of the directory.

    `kind` is "added", "updated" or "removed". `subject` is the channel or host after the change, or before its removal.
    `index` is the position of the change in the replicated log.
    """

    index: int
    kind: ChangeKind
    subject: ChannelInfo | HostInfo
