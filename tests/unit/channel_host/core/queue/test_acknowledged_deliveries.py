"""The number of acknowledged deliveries that a queue remembers, and the time for which it remembers them."""

from __future__ import annotations

from stampede_rt_channel_host.core.queue.acknowledged_deliveries import KEPT_NANOS, AcknowledgedDeliveries


def test_acknowledged_deliveries_are_known_to_their_taker_for_ten_minutes() -> None:
    known = AcknowledgedDeliveries()
    known.record(7, 1, 100)
    known.record(300, 2, 200)
    assert known.knows(7, 1, 100 + KEPT_NANOS - 1)
    assert not known.knows(7, 1, 100 + KEPT_NANOS)
    assert not known.knows(7, 2, 100)
    assert [(one.delivery_id, one.taker_id, one.time) for one in known.all(300)] == [(7, 1, 100), (300, 2, 200)]


def test_acknowledged_deliveries_are_bounded_and_forgotten() -> None:
    known = AcknowledgedDeliveries(chunks_max=2)
    for delivery_id in range(1, 1025):
        known.record(delivery_id, 1, delivery_id)
    assert not known.knows(1, 1, 1024)
    assert known.knows(1024, 1, 1024)
    assert known.footprint_bytes <= 3 * 4096
    known.record(5000, 1, 10**15)
    assert known.footprint_bytes == 4096
