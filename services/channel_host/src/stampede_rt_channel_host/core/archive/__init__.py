"""Archives of channels: the contents of their files, and reads over an archive and memory. Pure: values in, values out.

The shell, `stampede_rt_channel_host.archive`, has these duties:

- It writes the blocks that `encode_items` and `encode_gap` make, in seq order, and tells the channel when they are on
  stable storage (`ChannelCore.record`). Until then retention keeps the items in memory.
- It scans the segments of a folder with `scan`, and cuts off the torn tail of the last one.
- For a read that reaches below the items in memory, it makes an `ArchivedRead` of a `ChannelSnapshot`, loads each
  window that the read wants (`choose`, `decode_items`, `window_of`), and sends the answer.
"""

from stampede_rt_channel_host.core.archive.archived_part import (
    ArchivedPart,
    choose_part,
    deliver,
    lacked,
    next_time_of,
    part_of,
)
from stampede_rt_channel_host.core.archive.archived_read import (
    ArchivedRead,
    WantedWindow,
    reach_of,
    reaches,
    resolved,
    resolved_now,
)
from stampede_rt_channel_host.core.archive.block import (
    ADVANCE_BYTES,
    ADVANCES,
    GAP,
    HEAD_BYTES,
    ITEMS,
    NOTHING_LOST,
    OPENING,
    ROW_BYTES,
    ArchivedAdvance,
    ArchivedRun,
    BlockHead,
    CutRun,
    TimeRange,
    decode_advances,
    decode_head,
    decode_items,
    encode_advances,
    encode_gap,
    encode_items,
    encode_opening,
    is_whole,
)
from stampede_rt_channel_host.core.archive.doubts import Doubt, doubts_in
from stampede_rt_channel_host.core.archive.holes import Hole, WindowReach, border_holes, holes
from stampede_rt_channel_host.core.archive.past_archive import (
    NextItems,
    PastArchive,
    PastFacts,
    RunsOf,
    is_nothing_left,
    nothing_left,
    past_moment,
    past_of,
    read_nothing,
)
from stampede_rt_channel_host.core.archive.recorded_items import ArchiveSpan, span_of
from stampede_rt_channel_host.core.archive.segment import (
    PlacedBlock,
    ReadAt,
    Segment,
    SegmentScan,
    grown,
    scan,
    summary,
)
from stampede_rt_channel_host.core.archive.segment_blocks import BLOCK_INDEX_BYTES, SegmentBlocks
from stampede_rt_channel_host.core.archive.window import (
    ArchiveWindow,
    BlocksOf,
    ChosenBlocks,
    WantedItems,
    WindowNeedsThread,
    choose,
    choose_by_seq,
    window_of,
)

__all__ = [
    "ADVANCES",
    "ADVANCE_BYTES",
    "BLOCK_INDEX_BYTES",
    "GAP",
    "HEAD_BYTES",
    "ITEMS",
    "NOTHING_LOST",
    "OPENING",
    "ROW_BYTES",
    "ArchiveSpan",
    "ArchiveWindow",
    "ArchivedAdvance",
    "ArchivedPart",
    "ArchivedRead",
    "ArchivedRun",
    "BlockHead",
    "BlocksOf",
    "ChosenBlocks",
    "CutRun",
    "Doubt",
    "Hole",
    "NextItems",
    "PastArchive",
    "PastFacts",
    "PlacedBlock",
    "ReadAt",
    "RunsOf",
    "Segment",
    "SegmentBlocks",
    "SegmentScan",
    "TimeRange",
    "WantedItems",
    "WantedWindow",
    "WindowNeedsThread",
    "WindowReach",
    "border_holes",
    "choose",
    "choose_by_seq",
    "choose_part",
    "decode_advances",
    "decode_head",
    "decode_items",
    "deliver",
    "doubts_in",
    "encode_advances",
    "encode_gap",
    "encode_items",
    "encode_opening",
    "grown",
    "holes",
    "is_nothing_left",
    "is_whole",
    "lacked",
    "next_time_of",
    "nothing_left",
    "part_of",
    "past_moment",
    "past_of",
    "reach_of",
    "reaches",
    "read_nothing",
    "resolved",
    "resolved_now",
    "scan",
    "span_of",
    "summary",
    "window_of",
]
