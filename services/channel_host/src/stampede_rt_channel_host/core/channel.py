"""One channel: puts, reads, retention and subscriptions as plain values and `now` (paper, sections 3.1 to 3.4). Pure."""

from __future__ import annotations

from stampede_rt.model import Policy
from stampede_rt.timeline import Bound
from stampede_rt_channel_host.core.reading import Pending
from stampede_rt_channel_host.core.subscribing import AllCursor, NewestCursor
from stampede_rt_channel_host.core.values import (
    Answer,
    Counters,
    DeliveredSlice,
    Delivery,
    Offer,
    Position,
    PutOutcome,
    Query,
    Seal,
    WakeAt,
)


class Channel:
    """The items of one channel, in memory. Not thread-safe: one owner calls it, each call is atomic and never blocks.

    Every call takes `now`, the host's clock (`HostTime`), in nanoseconds since the epoch; an earlier one than before
    counts as the latest seen. After each put, advance and configure the owner polls its blocked gets, offers waiting
    puts again and looks after its subscriptions. Seqs start at 1.
    """

    def __init__(self, policy: Policy, *, incarnation: int, name: str = "") -> None:
        """An empty channel. Raises InvalidArgument if the policy cannot hold (see `Limits.of`)."""

    def put(self, offer: Offer, now: int, seal: Seal) -> PutOutcome:
        """Accept or refuse each item of `offer`, in order, as so many puts at one instant; store the accepted as a run.

        `seal` is called once if any item was accepted. Nothing of the offer is changed or kept. See PutOutcome for
        items that have to wait. Puts that arrive while one waits are to wait behind it, so that a run's seqs follow
        each other.
        """

    def give_up_put(self, offer: Offer) -> PutOutcome:
        """Refuse the items that waited in vain, each with ChannelFull, and count them."""

    def reject_malformed(self, items: int) -> None:
        """Count items that the shell refused before they became an offer."""

    def read(self, query: Query, now: int) -> Answer:
        """What the channel holds of the query, at once. Changes nothing that another reader could see.

        Raises IncarnationLost if a position comes from another incarnation.
        """

    def begin(self, query: Query, now: int) -> Pending:
        """Begin a blocking get: anchors are resolved now, or at the first poll when they can be. Then poll at once.

        Raises IncarnationLost if a position comes from another incarnation.
        """

    def poll(self, pending: Pending, now: int) -> Answer | WakeAt:
        """The blocking get's answer, or when to poll again.

        Released by the first matching item, with `complete` when the interval is finished, and in any case once
        nothing can come: the interval lies below the frontier, is empty, or is finished.
        """

    def give_up(self, pending: Pending, now: int) -> Answer:
        """What there is when the get's time is over, with its reason."""

    def subscribe_all(
        self, now: int, *, start: Bound | None = None, start_exclusive: bool = False, after: Position | None = None
    ) -> AllCursor:
        """Begin a subscription in seq order: held items from `start` on, or all accepted behind `after`, then new ones.

        Neither: only new ones. Both: InvalidArgument. `after` needs its seq. Raises IncarnationLost.
        """

    def since(self, cursor: AllCursor, now: int, limit_bytes: int) -> Delivery:
        """Take the next part: slices of about `limit_bytes` (payload and overhead; one slice at least). Moves the cursor.

        What retention collected before it was taken is reported once, as a gap. Empty: wait for the next put.
        """

    def subscribe_newest(
        self, now: int, *, start: Bound | None = None, start_exclusive: bool = False, after: Position | None = None
    ) -> NewestCursor:
        """Begin a subscription to the latest item. With `start` the present newest comes first, if it is not earlier.

        Raises like `subscribe_all`.
        """

    def latest(self, cursor: NewestCursor, now: int) -> DeliveredSlice | None:
        """Take the newest item if it is later than the last taken. Moves the cursor; `cursor.skipped` counts the rest."""

    def skipped(self, cursor: NewestCursor) -> int:
        """Items meant for this subscription that it was not given, up to now."""

    def advance(self, instant: int, now: int) -> int:
        """Promise that nothing earlier than `instant` will come; gives the highest promise. Raises InFuture."""

    def configure(self, policy: Policy, now: int) -> None:
        """Set another policy, whole; what it outdates goes at once. Raises InvalidArgument and changes nothing.

        Walks the index once if it outdates much.
        """

    def collect(self, now: int, entries_max: int = 1024) -> bool:
        """Free memory of outdated items, a bounded part; True if more is left. Puts and reads do a little of it too."""

    def next_deadline(self, now: int) -> int | None:
        """When `collect` is next useful: at an instant, or None if time alone outdates nothing."""

    def counters(self, now: int) -> Counters:
        """What became of all items, at this moment."""

    @property
    def policy(self) -> Policy:
        """The policy as stated."""

    @property
    def incarnation(self) -> int:
        """Which life of the channel the seqs belong to."""

    @property
    def next_seq(self) -> int:
        """The seq that the next accepted item gets."""

    @property
    def newest(self) -> int | None:
        """The newest item's time, as of the last call that took `now`."""

    @property
    def oldest(self) -> int | None:
        """The oldest held item's time, as of the last call that took `now`."""

    @property
    def frontier(self) -> int | None:
        """The latest span end that age, count or bytes have collected, not above the oldest held item's time."""

    @property
    def advanced_to(self) -> int | None:
        """The highest promise that nothing earlier will come."""
