"""A proxy as callers see it, from the status that the host of the copy sends."""

from __future__ import annotations

import pytest

from stampede_rt.v1 import channel_pb2, replica_pb2
from stampede_rt.values.seq_starts import start_of
from stampede_rt.wire.records import proxy_info


@pytest.mark.parametrize(
    ("copy", "waiting"),
    [
        (channel_pb2.CopyStatus(source_next_seq=start_of(2) + 9, missed=2, waiting=4), 4),
        (channel_pb2.CopyStatus(source_next_seq=20, missed=2), 12),  # from a host of an earlier release
    ],
)
def test_a_proxy_has_the_number_of_waiting_items_that_its_host_says(copy: channel_pb2.CopyStatus, waiting: int) -> None:
    status = channel_pb2.ChannelStatus(counters=channel_pb2.ChannelCounters(accepted=5), copy=copy)
    found = proxy_info("cam", replica_pb2.ReplicaRecord(), {}, status)
    assert (found.missed, found.waiting) == (2, waiting)
