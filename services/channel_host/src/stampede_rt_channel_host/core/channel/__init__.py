"""The channel core: values and `now` in, values out (paper, sections 3.1 to 3.4).

Nothing here reads a clock, waits, locks, or knows the wire. The shell around it:

- makes one `ChannelCore` for each channel from its Policy and incarnation;
- passes `now` from one `HostTime` to every call;
- puts: `channel.put(Offer(...), now, seal) -> PutOutcome`, `seal` giving the stored bytes once the first seq is known;
  where `outcome.waiting` is set, it offers `offer.rest(waiting, now)` again after each change and at `outcome.retry_at`
  (keeping later puts behind it), or calls `give_up_put`; a retried put is recognised by `RetryWindow` before;
- reads: `channel.read(Query(...), now) -> Answer`; blocking ones by `begin`, `poll` (at once, after each change and at
  the instant of `WakeAt`), `give_up`;
- subscriptions: `subscribe_all` and `since`, `subscribe_newest` and `latest`;
- consumption: `consume`, `consumers`; `consumer_places` and `restore_consumers` carry the places to another owner;
- housekeeping: `collect(now)` at `next_deadline(now)`, again at once while it returns True;
- long work: reads and subscriptions that begin with much come in pieces, too (`reading`, `polling`, `giving_up`,
  `subscribing_all`); between two pieces the channel may be used, and the result is as of the first one;
- counts: `counters(now)`; `reject_malformed` for what never became an offer.

"After each change" means after every put that accepted something, every advance and every configure; waiting puts are
offered again after every consume, too.
"""

from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.consumption import (
    LEASE_NANOS,
    LEASE_NANOS_MAX,
    SEQS_MAX,
    Consumed,
    ConsumerPlace,
    ConsumerStanding,
)
from stampede_rt_channel_host.core.channel.gathered import drained, emptying
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.moment import HeldThen, Moment
from stampede_rt_channel_host.core.channel.pieces import Pieces, Unfinished, abandoning, batched, first_of, run_to_end
from stampede_rt_channel_host.core.channel.reading import Pending
from stampede_rt_channel_host.core.channel.run import ABSENT, ITEM_OVERHEAD_BYTES, ColumnRun, Run, Slice, Slicer
from stampede_rt_channel_host.core.channel.subscribing import AllCursor, NewestCursor
from stampede_rt_channel_host.core.channel.values import (
    Counters,
    DeliveredSlice,
    Gap,
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
from stampede_rt_channel_host.core.channel.waiting import AFTER_ALL, BEFORE_ALL, Coming, Needs, Reach

__all__ = [
    "ABSENT",
    "AFTER_ALL",
    "BEFORE_ALL",
    "ITEM_OVERHEAD_BYTES",
    "LEASE_NANOS",
    "LEASE_NANOS_MAX",
    "SEQS_MAX",
    "AllCursor",
    "ChannelCore",
    "ChannelLimits",
    "ColumnRun",
    "Coming",
    "Consumed",
    "ConsumerPlace",
    "ConsumerStanding",
    "Counters",
    "DeliveredSlice",
    "Gap",
    "HeldThen",
    "Moment",
    "Needs",
    "NewestCursor",
    "Offer",
    "Pending",
    "Pieces",
    "Position",
    "PutOutcome",
    "Query",
    "Reach",
    "ReadAnswer",
    "Rejection",
    "Run",
    "SavedCursor",
    "Seal",
    "Slice",
    "Slicer",
    "SubscriptionBatch",
    "Unfinished",
    "WakeAt",
    "abandoning",
    "batched",
    "drained",
    "emptying",
    "first_of",
    "run_to_end",
]
