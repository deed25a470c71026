"""The benchmark removes the shared memory that Zenoh processes left when they ended, and nothing else."""

from __future__ import annotations

import mmap
from pathlib import Path

from stampede_rt_bench.peers.zenoh_segments import segments_removed


def test_segments_that_appeared_meanwhile_and_are_not_mapped_are_removed(tmp_path: Path) -> None:
    before, left, used, other = (tmp_path / name for name in ("1.zenoh", "2.zenoh", "3.zenoh", "4.other"))
    before.touch()
    with segments_removed(tmp_path):
        left.touch()
        other.touch()
        used.write_bytes(bytes(mmap.PAGESIZE))
        with used.open("r+b") as file:
            mapped = mmap.mmap(file.fileno(), 0)
    assert {path.name for path in tmp_path.iterdir()} == {"1.zenoh", "3.zenoh", "4.other"}
    mapped.close()
