"""Channel groups: values and `now` in, values out (paper, sections 3.3 and 4.1).

Nothing here reads a clock, waits, or knows the wire. The shell around it, at each host:

- keeps one `TimesBoard`: own channels by `OwnTimes.observe` after each change, then `tell_own`; those of other hosts by
  `hear` as their owners tell, and by `confirm` at each sign of life;
- keeps one `GroupCut` per group: `merge_floor` with what other hosts know, `confirm` when all that live have told it,
  `refresh` after each change of the board and at `next_idle`. A client's word never goes in: a reader that has seen
  more waits until `cut` is there, or is answered with `VisibleChannel.stalled`;
- reads through a group: `VisibleChannel` like a channel, with the `Horizon` of the moment, or with an earlier cut to
  read several channels at one; blocked gets are polled after each change of the channel and of the cut;
- subscriptions through a group: `VisibleAll`, `VisibleNewest`;
- cut events: the host that decides feeds an `EventDecider`; every host takes its own channels' parts of an event by
  `CutFollower.begin(boundary)` and `take`, once its own cut has come as far. Cut and `next_seq` resume it;
- matches: a `Matcher` at the owner of the one channel, with an `OwnTrack` or a `FarTrack` for every other;
- status: `GroupCut.members` and `waiting_on`, `VisibleChannel.hidden_items` and `window_too_short`.
"""

from stampede_rt_channel_host.core.group.cut import (
    MAX_LEAD_NANOS_DEFAULT,
    CutFloor,
    CutMember,
    GroupCut,
    GroupDefinition,
)
from stampede_rt_channel_host.core.group.deciding import MAX_WAIT_NANOS_DEFAULT, Boundary, EventDecider
from stampede_rt_channel_host.core.group.following import CutFollower, Loss, Step
from stampede_rt_channel_host.core.group.matching import OWN, FoundMatch, Matcher
from stampede_rt_channel_host.core.group.subscribing import VisibleAll, VisibleNewest
from stampede_rt_channel_host.core.group.times import ChannelTimes, Heard, OwnTimes, TimesBoard
from stampede_rt_channel_host.core.group.tracks import FarTrack, Nearest, OwnTrack, Track
from stampede_rt_channel_host.core.group.visible import Horizon, VisibleChannel, polling

__all__ = [
    "MAX_LEAD_NANOS_DEFAULT",
    "MAX_WAIT_NANOS_DEFAULT",
    "OWN",
    "Boundary",
    "ChannelTimes",
    "CutFloor",
    "CutFollower",
    "CutMember",
    "EventDecider",
    "FarTrack",
    "FoundMatch",
    "GroupCut",
    "GroupDefinition",
    "Heard",
    "Horizon",
    "Loss",
    "Matcher",
    "Nearest",
    "OwnTimes",
    "OwnTrack",
    "Step",
    "TimesBoard",
    "Track",
    "VisibleAll",
    "VisibleChannel",
    "VisibleNewest",
    "polling",
]
