"""A short campaign of faults of archives; `python -m tests.robustness.archives` runs the long one."""

from __future__ import annotations

from pathlib import Path

import pytest

import stampede_rt as st
from tests.robustness.archives.campaign import Campaign
from tests.support.channel_host.small_disk import NoSmallDisk, small_disk
from tests.support.cluster import running_cluster


def test_no_acknowledged_item_is_lost_by_kills_full_disks_and_flipped_bits(tmp_path: Path) -> None:
    try:
        with (
            small_disk(tmp_path, 16 * 2**20) as disk,
            running_cluster(hosts=1, supernodes=1, archive=disk) as cluster,
            st.connect(cluster.address) as rt,
        ):
            found = Campaign(cluster, rt, disk, seed=7).run(["kill", "full disk", "kill", "flipped bit", "stop"])
    except NoSmallDisk as error:
        pytest.skip(str(error))
    assert found.lost == []
    assert found.acked > 0
    assert found.refused > 0
