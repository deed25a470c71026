"""The reads of a recorded channel at a copy. The copy has no archive. It sends a reader to the owner if a read may need
the archive.
"""

from __future__ import annotations

from stampede_rt.errors import StampedeError
from stampede_rt.values.timeline import MIN_INSTANT
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.archive import ArchiveSpan, needs_archive, resolved_now
from stampede_rt_channel_host.core.channel import Query
from stampede_rt_channel_host.core.group import Horizon, reaches_archive


def lacks_archive(hosted: HostedChannel) -> bool:
    """Whether only the owner has the archive of this channel."""
    return hosted.copy is not None and hosted.record.policy.is_recorded


def refusal(hosted: HostedChannel) -> StampedeError:
    """The error that sends a reader of archived items to the owner."""
    return refusals.copy_cannot(hosted.record.name, "has no archive, and the reader may need archived items")


def check_read(hosted: HostedChannel, query: Query, now: int, horizon: Horizon | None = None) -> None:
    """Check that a read needs no item that only the archive of the owner has.

    `horizon`: the horizon of the group through which the caller reads; None: it reads through no group. Raises
    StaleBinding (MOVED).
    """
    if not lacks_archive(hosted):
        return
    held, _ = hosted.channel.look(now)
    lost_before = hosted.channel.lost_before  # the owner's archive may have items from before this instant
    has_earlier = held.newest_collected is not None or lost_before is not None
    span = ArchiveSpan(MIN_INSTANT if has_earlier else None, None, is_cut=False)
    if horizon is not None:
        is_refused = reaches_archive(held, span, query, horizon, now)
    else:
        # None: a bound is NEWEST or OLDEST, and this copy knows no item
        within = resolved_now(held, span, query, now)
        is_early = within is not None and lost_before is not None and within.start < lost_before
        is_refused = has_earlier if within is None else is_early or needs_archive(held, span, query, within)
    if is_refused:
        raise refusal(hosted)
