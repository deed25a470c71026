"""The channel core: values and `now` in, values out (paper, sections 3.1 to 3.4).

No module here reads a clock, waits, locks, or knows the wire. The caller, which is the shell of channels, has these
duties:

- The caller makes one `ChannelCore` for each channel from its Policy and incarnation.
- The caller passes `now` from one `HostTime` to every call.
- Puts: the caller first asks `RetryWindow`, which recognises retried puts. Then the caller calls
  `channel.put(Offer(...), now, seal) -> PutOutcome`. The channel calls `seal` with the first seq and gets the bytes to
  store. If `outcome.waiting` is set, the caller holds later puts back, and offers `offer.rest(waiting, now)` again
  after each change and at `outcome.retry_at`. `give_up_put` refuses the items whose wait is over.
- Reads: the caller calls `channel.read(Query(...), now) -> ReadAnswer`. A blocking get needs `begin`, `poll` and
  `give_up`. The caller polls right after `begin`, after each change, and at the instant of `WakeAt`.
- Subscriptions: the caller calls `subscribe_all` and then `since`, or `subscribe_newest` and then `latest`.
- Consumption: the caller calls `consume` and `consumers`. `consumer_places` and `restore_consumers` move the places to
  another owner.
- Copies: the source's host calls `ChannelFeed(channel, place, now)` and then `take`. The copy's host makes a
  `FedChannel`, and passes each part to `apply`. The feed has the retry window if the copy may become the owner
  (`as_owner`).
- Housekeeping: the caller calls `collect(now)` at `next_deadline(now)`, and repeats the call while it returns True.
- Long work: for reads and for the beginning of subscriptions there are methods that work in pieces (`reading`,
  `polling`, `giving_up`, `subscribing_all`). Other calls may use the channel between two pieces. The result is as of
  the first piece.
- Counts: the caller calls `counters(now)`, and `reject_malformed` for items that never became an offer.

"After each change" means after every put that accepted an item, every advance and every configure. Waiting puts are
offered again after every consume, too.
"""

from stampede_rt_channel_host.core.channel.acceptance import REASONS
from stampede_rt_channel_host.core.channel.acceptances import Acceptances, AcceptedAdvance, AcceptedRows
from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.channel_snapshot import ChannelSnapshot, HoldingsSnapshot
from stampede_rt_channel_host.core.channel.consumer_places import (
    CONSUMED_RANGE_BYTES,
    CONSUMER_BYTES,
    LEASE_NANOS,
    ConsumerPlace,
    ConsumerStanding,
)
from stampede_rt_channel_host.core.channel.consumption import LEASE_NANOS_MAX, SEQS_MAX, ConsumptionResult
from stampede_rt_channel_host.core.channel.fed_channel import FedChannel
from stampede_rt_channel_host.core.channel.feeding import (
    CATCH_UP_NANOS,
    ChannelFeed,
    CollectionFacts,
    FeedPart,
    FeedPlace,
    LagWatch,
)
from stampede_rt_channel_host.core.channel.former_incarnations import FORMER_MAX, FormerIncarnation, Losses
from stampede_rt_channel_host.core.channel.held_items import COLLECTED_FOR
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.new_item import FedItem, NewFloor, NewItem
from stampede_rt_channel_host.core.channel.owner_facts import FedPlaces, OwnerFacts, OwnerPart
from stampede_rt_channel_host.core.channel.pieces import (
    Pieces,
    UnfinishedWork,
    abandoning,
    batched,
    batched_keys,
    first_of,
    one_after_another,
    rest_of,
    run_to_end,
)
from stampede_rt_channel_host.core.channel.reading import PendingGet
from stampede_rt_channel_host.core.channel.replicated_view import ReplicatedView
from stampede_rt_channel_host.core.channel.run import (
    ABSENT,
    ITEM_OVERHEAD_BYTES,
    Body,
    ColumnRun,
    ReferencedBody,
    Run,
    SingleItemRun,
    Slice,
    Slicer,
    make_run,
)
from stampede_rt_channel_host.core.channel.slices_in_parts import drained, emptying
from stampede_rt_channel_host.core.channel.subscribing import AllCursor
from stampede_rt_channel_host.core.channel.subscribing_newest import NewestCursor
from stampede_rt_channel_host.core.channel.values import (
    Counters,
    DeliveredSlice,
    Gap,
    GrowingCounts,
    Offer,
    Position,
    PutOutcome,
    Query,
    ReadAnswer,
    Rejection,
    SavedCursor,
    Seal,
    SubscriptionBatch,
    WakeAt,
)
from stampede_rt_channel_host.core.channel.waiting import AFTER_ALL, BEFORE_ALL, Needs, Reach, ReachTracker

__all__ = [
    "ABSENT",
    "AFTER_ALL",
    "BEFORE_ALL",
    "CATCH_UP_NANOS",
    "COLLECTED_FOR",
    "CONSUMED_RANGE_BYTES",
    "CONSUMER_BYTES",
    "FIRST_KEY",
    "FORMER_MAX",
    "ITEM_OVERHEAD_BYTES",
    "LEASE_NANOS",
    "LEASE_NANOS_MAX",
    "REASONS",
    "SEQS_MAX",
    "Acceptances",
    "AcceptedAdvance",
    "AcceptedRows",
    "AllCursor",
    "Body",
    "ChannelCore",
    "ChannelFeed",
    "ChannelLimits",
    "ChannelSnapshot",
    "CollectionFacts",
    "ColumnRun",
    "ConsumerPlace",
    "ConsumerStanding",
    "ConsumptionResult",
    "Counters",
    "DeliveredSlice",
    "FedChannel",
    "FedItem",
    "FedPlaces",
    "FeedPart",
    "FeedPlace",
    "FormerIncarnation",
    "Gap",
    "GrowingCounts",
    "HoldingsSnapshot",
    "ItemKey",
    "LagWatch",
    "Losses",
    "Needs",
    "NewFloor",
    "NewItem",
    "NewestCursor",
    "Offer",
    "OwnerFacts",
    "OwnerPart",
    "PendingGet",
    "Pieces",
    "Position",
    "PutOutcome",
    "Query",
    "Reach",
    "ReachTracker",
    "ReadAnswer",
    "ReferencedBody",
    "Rejection",
    "ReplicatedView",
    "Run",
    "SavedCursor",
    "Seal",
    "SingleItemRun",
    "Slice",
    "Slicer",
    "SubscriptionBatch",
    "UnfinishedWork",
    "WakeAt",
    "abandoning",
    "batched",
    "batched_keys",
    "drained",
    "emptying",
    "first_of",
    "make_run",
    "one_after_another",
    "rest_of",
    "run_to_end",
]
