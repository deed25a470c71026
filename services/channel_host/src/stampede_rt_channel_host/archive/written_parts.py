"""The items, gaps and advances that one write appends to the files of a channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from stampede_rt_channel_host.core.archive import ArchivedAdvance, ArchivedRun


class SeqGap(NamedTuple):
    """Seqs whose items the archive does not have: `first_seq` up to `end_seq`, exclusive.

    `lost_before`, if stated: items before this instant were lost with a host, and their seqs are not known.
    """

    first_seq: int
    end_seq: int
    lost_before: int | None = None


class Advances(NamedTuple):
    """Advances of the channel, in the order of their acceptance. `seq`: the seq of the next item to write."""

    seq: int
    rows: tuple[ArchivedAdvance, ...]


WrittenPart = Sequence[ArchivedRun] | SeqGap | Advances
