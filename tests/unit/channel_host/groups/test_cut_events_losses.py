"""Reports of lost items whose times lie beyond the range of instants, because of an overlap or a long duration."""

from __future__ import annotations

import pytest

from stampede_rt.values.model import Reason
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from stampede_rt_channel_host.core.group import Loss
from stampede_rt_channel_host.groups.cut_events import loss_message


@pytest.mark.parametrize(
    ("before", "reported"),
    [(-16_875_299_848_123_760_968, MIN_INSTANT), (MAX_INSTANT + 1, MAX_INSTANT), (5, 5)],
)
def test_a_loss_before_or_after_all_times_is_reported_at_the_first_or_last_time(before: int, reported: int) -> None:
    loss = Loss(before=before, items=1, is_exact=True, reason=Reason("COLLECTED"), first_seq=1, last_seq=1)
    assert loss_message(loss).before_unix_nano == reported
