"""The values that callers hold: items, answers, descriptions of channels and hosts. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, overload

from stampede_rt.values.timeline import ResolvedInterval

REPR_BYTES_MAX = 32
OVERLAP_NANOS_MAX = 3_600_000_000_000
"""The greatest `Policy.overlap_nanos`: a read looks at each item of so long before its start."""

OnFull = Literal["drop_oldest", "block", "reject"]
"""What becomes of a put on a full channel or queue."""
ChangeKind = Literal["added", "updated", "removed"]


class Item(NamedTuple):
    """One item of a channel (paper, section 3.2). Times in nanoseconds since the epoch, durations in nanoseconds.

    `end` is the end of its span as known when it was read: the earliest of time + duration and the next later item's
    time; None while it is the newest and has no duration. `seq` grows by one for each item that the channel accepts.
    `payload` is None in reads without payloads. `incarnation` says which life of the channel the seq belongs to.
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
        """The payload as the handle's codec decodes it; without a codec the payload itself."""
        return self.payload

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


class Reason(str):
    """Why an answer is empty or partial; compares as a string, and `detail` explains it in a sentence."""

    COLLECTED: Reason
    NEVER: Reason
    NOT_YET: Reason
    HIDDEN: Reason
    LOST: Reason
    detail: str

    def __new__(cls, value: str, detail: str = "") -> Reason:
        """A reason with its explanation."""
        self = super().__new__(cls, value)
        self.detail = detail
        return self

    @property
    def value(self) -> str:
        """The plain string."""
        return str(self)


for _name in ("COLLECTED", "NEVER", "NOT_YET", "HIDDEN", "LOST"):
    setattr(Reason, _name, Reason(_name))


class Items(Sequence[Item]):
    """The answer to a get: items in time order (or the reverse), and what the reader must know beside them.

    `interval` is the interval as the host resolved it (None if it hung on items and there were none); `complete`:
    nothing more can come into it; `truncated`: earlier items in it may have been collected; `more`: the limit cut it;
    `reason`: why it is empty or partial, None if nothing is missing; `cut`: what the group showed when it was read
    through one, items before this instant; None: through none, or nothing was visible yet.
    """

    __slots__ = ("_items", "complete", "cut", "incarnation", "interval", "more", "reason", "truncated")

    def __init__(
        self,
        items: Sequence[Item],
        *,
        interval: ResolvedInterval | None,
        complete: bool,
        truncated: bool,
        more: bool,
        reason: Reason | None,
        incarnation: int,
        cut: int | None = None,
    ) -> None:
        self._items = items
        self.interval = interval
        self.complete = complete
        self.truncated = truncated
        self.more = more
        self.reason = reason
        self.incarnation = incarnation
        self.cut = cut

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | Sequence[Item]:
        return self._items[index]

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Item]:
        return iter(self._items)

    def __repr__(self) -> str:
        reason = f", reason={self.reason}" if self.reason else ""
        return f"<Items: {len(self)}, complete={self.complete}{reason}>"


@dataclass(frozen=True, kw_only=True, slots=True)
class Policy:
    """How a channel is set up; None: never stated. Times in nanoseconds, sizes in bytes (paper, section 3.4).

    `max_age_unconsumed_nanos`: what a live consumer has yet to consume goes at that age instead of `max_age_nanos`.
    `overlap_nanos`: how long an item with a duration is not cut by the next item; None: not at all.
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


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelInfo:
    """A channel as the directory knows it."""

    channel_id: bytes
    name: str
    host_id: bytes
    host: str
    host_alive: bool
    epoch: int
    incarnation: int
    policy: Policy
    spec_version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class HostInfo:
    """A channel host as the directory knows it."""

    host_id: bytes
    name: str
    endpoints: Sequence[str]
    alive: bool
    channels: int
    version: str


@dataclass(frozen=True, kw_only=True, slots=True)
class SupernodeInfo:
    """A supernode as the answering one sees it."""

    supernode_id: str
    endpoint: str
    is_leader: bool
    healthy: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class ConsumerStats:
    """A consumer's place at a channel that counts consumption: how many held items it has yet to consume (`waiting`).

    `lease_nanos` 0: its lease has ended, and it holds no item back until the place is taken again.
    """

    consumer_id: int
    lease_nanos: int
    waiting: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelStats:
    """A channel's counters, taken at one moment: `accepted == held + sum(collected.values())`, always.

    `collected` is by cause (age, count, bytes, consumption), `rejected` by reason. Times are in nanoseconds since the
    epoch, None where there are none. `consumers` are the places that were taken, of `policy.consumers`.
    `clock_offset_nanos` is how far the host's clock was ahead of this machine's, measured by the call that asked for
    these, give or take half its round trip; None in a listing.
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


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """One change of the directory: `kind` is "added", "updated" or "removed"; `subject` is as it is after it."""

    index: int
    kind: ChangeKind
    subject: ChannelInfo | HostInfo
