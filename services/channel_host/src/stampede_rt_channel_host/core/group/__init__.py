"""Channel groups: values and `now` in, values out (paper, sections 3.3 and 4.1).

No module here reads a clock, waits, or knows the wire. The shell of groups has these duties at each host:

- It keeps one `TimesBoard`. For each channel of its own host it calls `OwnChannelTimes.observe` after each change, and
  then `enter_own`. For channels of other hosts it calls `receive` with their owners' reports, and `confirm` at each
  sign of life.
- It keeps one `GroupCut` per group. It calls `merge_floor` with the cuts of other hosts, `confirm` as soon as all
  live hosts have sent their cuts, and `refresh` after each change of the board and at `next_idle`. It never passes a
  client's cut to `merge_floor`. If a reader has seen a later cut, the reader waits until `cut` reaches the later cut,
  or gets the answer of `VisibleChannel.stalled`.
- Reads through a group use `VisibleChannel` like a channel, with the present `Horizon`. Reads of several channels at
  one cut use a `Horizon` with that cut, even when the group's cut has advanced. The shell polls blocked gets after each
  change of the channel and of the cut.
- A read that may want archived items performs the reads of a `RecordedView`. `reaches_archive` says which reads do.
- Subscriptions through a group use `VisibleAllCursor` or `VisibleNewestCursor`. For a recorded channel the shell
  performs each `RecordedStep` that `VisibleAllCursor.unheld_step` returns.
- Cut events: one host decides them and feeds an `EventDecider`. Every host takes its own channels' parts of an event by
  `CutFollower.begin(boundary)` and `take`, as soon as its own cut has reached the boundary. A new follower continues
  from a cut and a `next_seq`.
- Matches: the owner of the matched channel keeps a `Matcher`, with a `LocalTrack` or `RemoteTrack` for each other
  member. A recorded channel has a `RecordedOwnTrack` or `RecordedTrack`. The shell performs the reads of each
  ItemsNotLoaded.
- To report the state of a group, it reads `GroupCut.members` and `waiting_on`, `VisibleChannel.hidden_items` and
  `window_too_short`.
"""

from stampede_rt_channel_host.core.group.cut import (
    MAX_LEAD_NANOS_DEFAULT,
    CutFloor,
    CutMember,
    GroupCut,
    GroupDefinition,
)
from stampede_rt_channel_host.core.group.deciding import MAX_WAIT_NANOS_DEFAULT, Boundary, EventDecider
from stampede_rt_channel_host.core.group.following import CutFollower, Loss, StepPart
from stampede_rt_channel_host.core.group.matching import OWN, FoundMatch, Matcher
from stampede_rt_channel_host.core.group.recorded_steps import RecordedStep
from stampede_rt_channel_host.core.group.recorded_track import (
    ItemsNotLoaded,
    RecordedOwnTrack,
    RecordedTrack,
    archived_item,
    found_item,
)
from stampede_rt_channel_host.core.group.recorded_view import RecordedView, reaches_archive
from stampede_rt_channel_host.core.group.subscribing import VisibleAllCursor, VisibleNewestCursor
from stampede_rt_channel_host.core.group.times import ChannelTimes, KnownTimes, OwnChannelTimes, TimesBoard
from stampede_rt_channel_host.core.group.tracks import LocalTrack, NearestItem, RemoteTrack, Track
from stampede_rt_channel_host.core.group.visible import Horizon, VisibleChannel, polling
from stampede_rt_channel_host.core.group.wanted_channels import WantedChannels

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
    "FoundMatch",
    "GroupCut",
    "GroupDefinition",
    "Horizon",
    "ItemsNotLoaded",
    "KnownTimes",
    "LocalTrack",
    "Loss",
    "Matcher",
    "NearestItem",
    "OwnChannelTimes",
    "RecordedOwnTrack",
    "RecordedStep",
    "RecordedTrack",
    "RecordedView",
    "RemoteTrack",
    "StepPart",
    "TimesBoard",
    "Track",
    "VisibleAllCursor",
    "VisibleChannel",
    "VisibleNewestCursor",
    "WantedChannels",
    "archived_item",
    "found_item",
    "polling",
    "reaches_archive",
]
