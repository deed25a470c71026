"""The speeds of writers: 300 KB frames, and items of 64 B.

The plain writer appends the same bytes to one file, with an fsync after each 16 MiB, as the archive of a host does when
there is much to write. The second plain writer gets the bytes from another process through a socket, as a host does.
JetStream stores in files and syncs them to the disk every 0.2 s, as the host does. Redis has an append-only file and an
fsync a second. JetStream and Redis write a quarter of the items.
"""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import stampede_rt as st
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_bench.peers.reachable import is_listening
from stampede_rt_bench.peers.redis_streams import RedisStreams
from stampede_rt_bench.workloads.processes import server
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.copies.messages import run_of
from stampede_rt_channel_host.core.archive import ArchivedRun
from stampede_rt_local.ports import free_ports
from tests.benchmarks.archive_cost.behind_socket import seconds_behind_socket
from tests.benchmarks.archive_cost.figures import heading, ratios, row, seconds_of, spread

SYNC_BYTES = 16 * 2**20
RUN_ITEMS = 100


class WriteWorkload(NamedTuple):
    """A number of items with one payload."""

    name: str
    payload: bytes
    items: int


FRAMES, SMALL = WriteWorkload("frames", os.urandom(300_000), 600), WriteWorkload("small", os.urandom(64), 300_000)
Writer = Callable[[WriteWorkload], float | None]
"""Writes all items; returns the items a second, or None if the system is not installed."""


def plain(folder: Path, workload: WriteWorkload, per_write: int = 1) -> float:
    """Append the items to a file of this folder, `per_write` in each write."""

    def write() -> None:
        waiting, many = 0, workload.payload * per_write
        with (folder / "plain").open("wb", buffering=0) as file:
            for _ in range(workload.items // per_write):
                waiting += file.write(many)
                if waiting >= SYNC_BYTES:
                    os.fsync(file)
                    waiting = 0
            os.fsync(file)

    taken = seconds_of(write)
    (folder / "plain").unlink()
    return workload.items / taken


def plain_behind_socket(folder: Path, workload: WriteWorkload, per_write: int) -> float:
    """Send the items to a process that appends them to a file of this folder, `per_write` in each write."""
    parts = workload.items // per_write
    return workload.items / seconds_behind_socket(folder / "plain", workload.payload * per_write, parts, SYNC_BYTES)


def archive_alone(folder: Path, workload: WriteWorkload) -> float:
    """Write the items with the archive of a host, without a host. The runs are made before the measurement."""
    per_run = 1 if workload is FRAMES else RUN_ITEMS
    body = seal_run(encode_run([workload.payload] * per_run, times=[*range(per_run)]), 1)
    runs = [ArchivedRun(1, run_of(body)) for _ in range(workload.items // per_run)]
    per_write = max(1, SYNC_BYTES // len(body))
    files = SegmentFiles(folder / "alone", {})
    files.open(1)

    def write() -> None:
        for at in range(0, len(runs), per_write):
            files.write([runs[at : at + per_write]], ArchiveLimits(None, None))

    taken = seconds_of(write)
    files.close(None)
    shutil.rmtree(folder / "alone")
    return workload.items / taken


def ours(rt: st.Connection, name: str, workload: WriteWorkload, **policy: str) -> float:
    """Put the items. If the channel is recorded, wait until the last item is on the disk."""
    channel = rt.channel(name, max_bytes=2**30, **policy)

    def put() -> None:
        with channel.producer() as producer:
            for _ in range(workload.items):
                producer.put(workload.payload)
        channel.put(workload.payload, ack="disk" if policy else None)

    taken = seconds_of(put)
    channel.delete()
    return workload.items / taken


def jetstream(folder: Path, workload: WriteWorkload) -> float | None:
    """Publish a quarter of the items into a stream in files."""
    from stampede_rt_bench.peers.nats_server import connect, nats_server, why_unavailable

    if why_unavailable():
        return None
    settings, items = folder / "nats.conf", workload.items // 4
    settings.write_text('jetstream { sync_interval: "200ms" }\n')

    async def publish(address: str) -> None:
        from nats.js.api import StorageType, StreamConfig

        connection = await connect(address)
        stream = connection.jetstream(publish_async_max_pending=64 if workload is FRAMES else 4000)
        await stream.add_stream(StreamConfig(name="COST", subjects=["cost"], storage=StorageType.FILE))
        for at in range(items):
            await stream.publish_async("cost", workload.payload)
            if not at % 64:
                await asyncio.sleep(0)
        await stream.publish_async_completed()
        await connection.close()

    with nats_server("--jetstream", "--config", str(settings)) as served:
        return items / seconds_of(lambda: asyncio.run(publish(served.address)))


def redis_file(folder: Path, workload: WriteWorkload) -> float | None:
    """Add a quarter of the items to a stream, with an append-only file, in pipelines of about 1 MiB."""
    if RedisStreams("tcp").unavailable_because():
        return None
    batch, items = max(1, 2**20 // len(workload.payload)), workload.items // 4
    with redis_server(folder) as client:

        def add() -> None:
            for at in range(0, items, batch):
                pipeline = client.pipeline(transaction=False)
                for _ in range(min(batch, items - at)):
                    pipeline.xadd("cost", {"p": workload.payload})
                pipeline.execute()

        return items / seconds_of(add)


@contextmanager
def redis_server(folder: Path) -> Iterator[Any]:
    """A client of a server whose append-only file is in a new folder."""
    import redis

    (port,) = free_ports(1, "127.0.0.1")
    files = folder / f"redis-{port}"
    files.mkdir()
    command = ["redis-server", "--port", str(port), "--save", "", "--appendonly", "yes", "--dir", str(files)]
    with server(command, folder / "log", lambda: is_listening(port)):
        yield redis.Redis(host="127.0.0.1", port=port, protocol=2)
    shutil.rmtree(files)


def writers_of(rt: st.Connection, here: st.Connection, folder: Path) -> dict[str, Writer]:
    """All writers, by the names of their rows. The others are compared with the first one."""
    return {
        "plain file": lambda workload: plain(folder, workload, 1 if workload is FRAMES else RUN_ITEMS),
        "plain file behind a socket": lambda workload: plain_behind_socket(
            folder, workload, 1 if workload is FRAMES else RUN_ITEMS
        ),
        "archive alone, without a host": lambda workload: archive_alone(folder, workload),
        "channel in memory": lambda workload: ours(rt, f"cost/{workload.name}/memory", workload),
        "recorded channel": lambda workload: ours(rt, f"cost/{workload.name}/recorded", workload, archive="forever"),
        "channel in memory of an embedded host": lambda workload: ours(here, f"cost/{workload.name}/here", workload),
        "recorded channel of an embedded host": lambda workload: ours(
            here, f"cost/{workload.name}/recorded-here", workload, archive="forever"
        ),
        "JetStream, file storage": lambda workload: jetstream(folder, workload),
        "Redis, append-only file": lambda workload: redis_file(folder, workload),
    }


def writing(rt: st.Connection, here: st.Connection, folder: Path, rounds: int) -> None:
    """Print the speeds of all writers. `here`: a connection whose program is a host with an archive in this folder."""
    writers = writers_of(rt, here, folder)
    rates: dict[tuple[str, str], list[float]] = {}
    for _ in range(rounds):
        for name, write in writers.items():
            for workload in (FRAMES, SMALL):
                rate = write(workload)
                if rate is not None:
                    rates.setdefault((name, workload.name), []).append(rate)
    heading("writer", "300 KB frames, MB/s", "of plain", "items of 64 B, thousand/s", "of plain")
    first, *_ = writers
    for name in writers:
        frames, small = rates.get((name, "frames")), rates.get((name, "small"))
        if frames is None or small is None:
            row(name, "not installed", "", "", "")
            continue
        frame_ratios, small_ratios = ratios(frames, rates[first, "frames"]), ratios(small, rates[first, "small"])
        speed = spread([one * len(FRAMES.payload) / 1e6 for one in frames], ".0f")
        row(name, speed, frame_ratios, spread([one / 1e3 for one in small], ".0f"), small_ratios)
