"""`take_pages`: the system allocates the pages of a mapping before the program uses them."""

from __future__ import annotations

import mmap
import os
from pathlib import Path

import pytest

from stampede_rt.transports import futexes
from stampede_rt.transports.mapped_pages import take_pages

pytestmark = pytest.mark.skipif(not futexes.is_supported(), reason="shared memory needs Linux on x86-64")

SIZE_BYTES = 2**20


def resident_bytes(name: str) -> list[int]:
    """Return the allocated bytes of each mapping of the file."""
    lines = iter(Path("/proc/self/smaps").read_text().splitlines())
    return [
        int(next(line for line in lines if line.startswith("Rss:")).split()[1]) * 1024 for line in lines if name in line
    ]


@pytest.mark.parametrize("to_write", [True, False])
def test_all_pages_of_a_mapping_are_allocated_before_their_first_use(to_write: bool) -> None:
    name = f"stampede-pages-{to_write}"
    file = os.memfd_create(name)
    try:
        os.posix_fallocate(file, 0, SIZE_BYTES)
        with mmap.mmap(file, SIZE_BYTES, prot=mmap.PROT_READ | (mmap.PROT_WRITE if to_write else 0)) as memory:
            assert resident_bytes(name) == [0]
            if not take_pages(memory, to_write=to_write):
                pytest.skip("the system is older than Linux 5.14")
            assert resident_bytes(name) == [SIZE_BYTES]
    finally:
        os.close(file)
