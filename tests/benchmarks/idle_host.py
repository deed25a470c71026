"""The cost of idle channels for a host: `python -m tests.benchmarks.idle_host [--channels 100000]`.

A cluster of processes: one front-end, one supernode and one host. The host fills its own store, step by step, and puts
one item into each channel, because clients would take an hour for this number. The rest of the host is as usual. After
each step the benchmark reads the CPU time and the resident memory of the whole host process. So the figures include all
that runs in an idle host: sweep, lease, watches, garbage collector and event loop.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import secrets
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence

from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_bench.clusters import SECRET_VARIABLE, running
from stampede_rt_bench.tables import Table
from stampede_rt_channel_host import app, served_host
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.cluster.registration import START_SECONDS_MAX
from stampede_rt_channel_host.host import ChannelHost
from stampede_rt_runtime.memory.huge_pages import start_again_with_huge_pages

FIRST_CHANNELS = 100  # their puts load code, whose memory does not count
CHANNELS_PER_TURN = 64
SETTLE_SECONDS = 2.0
PAYLOAD = b"x" * 64
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
AS_HOST = "--as-host"


class FilledHost(ChannelHost):
    """A host that carries out the lines of its standard input after it has entered the cluster."""

    async def enter(self, target: str, timeout_s: float = START_SECONDS_MAX, **targets: str) -> None:
        """See ChannelHost."""
        await super().enter(target, timeout_s, **targets)
        self._start(_heed(self), "orders")


async def _heed(host: ChannelHost) -> None:
    """Answer each line `CHANNELS SECONDS` with the share of a core and the resident bytes of this process."""
    orders = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(orders), sys.stdin)
    while order := await orders.readline():
        channels, seconds = order.decode().split()
        await _fill(host, int(channels))
        await asyncio.sleep(SETTLE_SECONDS)
        cpu_s, began_s = time.process_time(), time.monotonic()
        await asyncio.sleep(float(seconds))
        share = (time.process_time() - cpu_s) / (time.monotonic() - began_s)
        print(json.dumps([len(host.store.all()), share, _resident_bytes()]), flush=True)


async def _fill(host: ChannelHost, channels: int) -> None:
    """Make channels with one item each, as if callers had bound them, until the host has `channels` of them."""
    spec = policy_to_spec(Policy(max_age_nanos=10 * 10**9))
    for number in range(len(host.store.all()), channels):
        record = channel_pb2.ChannelRecord(
            channel_id=secrets.token_bytes(16), name=f"robots/{number % 1000}/sensors/{number}", epoch=1,
            host_id=host.identity.host_id, incarnation=secrets.randbits(63), spec=spec,
            created_by=f"robot{number % 2}",  # one caller may have three quarters of the channels
        )  # fmt: skip
        hosted = host.store.adopt(recorded_channel(record))
        run = IncomingRun(encode_run([PAYLOAD], times=None), producer_id=0, first_number=0, wait_nanos=None)
        hosted.puts.put(run, host.store.now())
        if number % CHANNELS_PER_TURN == 0:
            await asyncio.sleep(0)


def _resident_bytes() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * PAGE_BYTES


def measure(steps: Sequence[int], seconds: float, runs: int) -> Table:
    """Measure one host with each number of channels in `steps`."""
    table = Table(["channels", "% of a core", "resident MB", "bytes a channel"])
    with running(hosts=0) as address:
        command = [sys.executable, "-m", "tests.benchmarks.idle_host", AS_HOST, "--frontend", address]
        command += ["--secret-file", os.environ[SECRET_VARIABLE], "--log-level", "warning"]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as host:
            assert host.stdin is not None
            assert host.stdout is not None
            host.stdout.readline()  # the ready line
            empty_bytes = 0
            for count in (FIRST_CHANNELS, *steps):
                samples = []
                for _ in range(runs if count > FIRST_CHANNELS else 1):
                    print(count, seconds if count > FIRST_CHANNELS else 1, file=host.stdin, flush=True)
                    samples.append(json.loads(host.stdout.readline()))
                channels, _, resident_bytes = samples[-1]
                empty_bytes = empty_bytes or resident_bytes
                each_bytes = (resident_bytes - empty_bytes) / max(1, channels - FIRST_CHANNELS)
                shares = [100 * sample[1] for sample in samples]
                share = f"{statistics.median(shares):.1f} ({min(shares):.1f} to {max(shares):.1f})"
                row = (f"{channels:,}", share, f"{resident_bytes / 1e6:,.0f}", f"{each_bytes:,.0f}")
                table.rows.append(row)
            host.terminate()
    table.notes.append(f"{runs} runs of {seconds:g} s; medians (least to most). Goals: 3 % and 6,000 bytes.")
    return table


def main() -> int:
    """Print the table, or be the host. Returns the exit code."""
    if AS_HOST in sys.argv:
        start_again_with_huge_pages("tests.benchmarks.idle_host", sys.argv[1:])  # as a usual host
        served_host.ChannelHost = FilledHost  # type: ignore[misc]
        return app.main([one for one in sys.argv[1:] if one != AS_HOST])
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--channels", type=int, default=100_000, help="the most channels (default: 100000)")
    parser.add_argument("--seconds", type=float, default=20.0, help="the length of each run (default: 20)")
    parser.add_argument("--runs", type=int, default=3, help="the runs for each number of channels (default: 3)")
    arguments = parser.parse_args()
    steps = sorted({*(one for one in (1000, 10_000) if one < arguments.channels), arguments.channels})
    measure(steps, arguments.seconds, arguments.runs).print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
