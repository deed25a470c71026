"""The places of consumers, and the ends of their leases."""

from __future__ import annotations

from stampede_rt_channel_host.core.channel.consumer_places import PlaceTable
from stampede_rt_channel_host.core.deadlines import OUTDATED_PER_CALL_MAX


def test_a_lease_ends_in_time_although_many_others_were_renewed() -> None:
    """A search for deadlines skips a limited number of changed ones in one call."""
    consumers = 3 * OUTDATED_PER_CALL_MAX
    table = PlaceTable(consumers)
    for consumer_id in range(1, consumers + 1):
        place, _ = table.take(consumer_id, 1, 1)
        table.renew(place, 100)
        if consumer_id < consumers:
            table.renew(place, 1000)
    table.expire(200)
    assert not table.holds(consumers)
    assert table.live == consumers - 1
