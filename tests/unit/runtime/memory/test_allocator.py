"""A service returns freed memory to the system."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import contextlib, os, resource, sys, time
import grpc  # as in every service; grpc loads libgcc_s, which the end of a thread needs
from stampede_rt_runtime.memory import allocator

statm = os.open("/proc/self/statm", os.O_RDONLY)

def resident():
    return int(os.pread(statm, 256, 0).split()[1]) * resource.getpagesize()

allocator.TRIM_SECONDS = 0.01
allocator.give_back_memory()
if "without descriptors" in sys.argv:
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
    with contextlib.suppress(OSError):
        while True:
            os.dup(0)
before = resident()
blocks = [bytearray(9000) for _ in range(40_000)]  # smaller than blocks with a mapping of their own
held = blocks[::1000]  # some blocks stay, spread over the memory of all blocks
print(resident() - before > 300 * 2**20)
del blocks
while resident() - before > 100 * 2**20:
    time.sleep(0.01)
print("given back")
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the allocator of another C library is left as it is")
@pytest.mark.parametrize("how", ["as usual", "without descriptors"])
def test_memory_freed_between_used_blocks_is_returned_to_the_system(how: str) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, text=True, timeout=50)
    assert (done.stdout.split("\n"), done.stderr) == (["True", "given back", ""], "")
