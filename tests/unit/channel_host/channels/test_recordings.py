"""The refusal of recorded channels by a host without an archive."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt_channel_host.channels.recordings import Recordings


def test_a_host_without_an_archive_refuses_a_recorded_channel_with_its_name_and_advice() -> None:
    recordings = Recordings()
    recordings.check("rig/imu", is_recorded=False)
    with pytest.raises(InvalidArgument, match=r"rig/imu is to be recorded .* start the host with --archive FOLDER"):
        recordings.check("rig/imu", is_recorded=True)
