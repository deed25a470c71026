"""The streams of the paper's Figure 7: 30 frames and 2 captions a second, each with its own host and consumer.

Nothing but the times of the items coordinates the producer's two threads, both hosts and both consumers.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Literal, NamedTuple

import stampede_rt as st
from stampede_rt_bench.clusters import running
from stampede_rt_local.namespaces import NamespaceNetwork, NetworkNamespace

SECONDS = 8
PATIENCE_SECONDS = 20.0
NANOS_PER_SECOND, NANOS_PER_MS = 1_000_000_000, 1_000_000
LEAD_NANOS = 500 * NANOS_PER_MS
FRAMES_PER_SECOND, CAPTIONS_PER_SECOND = 30, 2
FRAME_NANOS = NANOS_PER_SECOND // FRAMES_PER_SECOND
FRAMES_PER_CAPTION = FRAMES_PER_SECOND // CAPTIONS_PER_SECOND
FRAME_BYTES, CAPTION_BYTES = 18_000, 512
DECODING_NANOS = 10 * NANOS_PER_MS
VIDEO, CAPTIONS, GROUP = "bench/video", "bench/captions", "bench/skew"
MACHINES = 4  # for the two hosts and the two consumers


class Receipt(NamedTuple):
    """An item's time, and when the get with this item returned."""

    time: int
    received: int


@dataclass(frozen=True, kw_only=True)
class Setting:
    """The conditions of one run.

    `grouped`: consumers read through a group. `bound`: the bound of the group; with "end" frames have durations. A
    caption begins `captions_after_nanos` after the beginning of a frame, and is put `decoding_nanos` later.
    """

    name: str
    grouped: bool = True
    bound: Literal["start", "end"] = "start"
    captions_after_nanos: int = 0
    decoding_nanos: int = DECODING_NANOS


def play(
    setting: Setting, network: NamespaceNetwork | None, seconds: int = SECONDS
) -> tuple[list[Receipt], list[Receipt]]:
    """Return the receipts of the consumers of frames and captions. Blocks for some seconds more than `seconds`.

    With a `network` of MACHINES namespaces every host and consumer has its own namespace.
    """
    context = multiprocessing.get_context("spawn")
    # Hosts come first.
    namespaces: Sequence[NetworkNamespace | None] = [None, None] if network is None else network.namespaces[2:MACHINES]
    with running(hosts=2, network=network) as address, st.connect(address) as rt, ExitStack() as pools:
        channels = [
            rt.channel(name, max_age="60s", host=host.name)
            for name, host in zip((VIDEO, CAPTIONS), rt.hosts(), strict=True)
        ]
        rt.group(GROUP, channels, reference="oldest", bound=setting.bound)
        # The consumers ignore Ctrl-C, so that they print nothing. This process ends them.
        ignoring_interrupts = signal.signal, (signal.SIGINT, signal.SIG_IGN)
        consumers = [pools.enter_context(context.Pool(1, *ignoring_interrupts)) for _ in channels]
        for consumer, channel, namespace in zip(consumers, channels, namespaces, strict=True):
            consumer.apply(prepare, (namespace, address, channel.name, setting.grouped))
        start = time.time_ns() + LEAD_NANOS
        span = start, start + seconds * NANOS_PER_SECOND
        received = [consumer.apply_async(consume, span) for consumer in consumers]
        _produce(channels, setting, *span)
        frames, captions = (one.get(timeout=PATIENCE_SECONDS) for one in received)
    return frames, captions


def _produce(channels: Sequence[st.Channel], setting: Setting, start: int, end: int) -> None:
    """Put frames and captions when they are due, on two threads as in the paper. Then advance both channels."""
    video, captions = channels
    frame_times = _times(start, end, FRAMES_PER_SECOND)
    caption_times = [at + setting.captions_after_nanos for at in _times(start, end, CAPTIONS_PER_SECOND)]
    interrupted = threading.Event()
    with ThreadPoolExecutor(2) as threads:
        putting = [
            threads.submit(_put_all, video, frame_times, 0, FRAME_BYTES, setting.bound == "end", interrupted),
            threads.submit(
                _put_all, captions, caption_times, setting.decoding_nanos, CAPTION_BYTES, False, interrupted
            ),
        ]
        try:
            for one in putting:
                one.result()
        except BaseException:
            interrupted.set()
            raise
    for channel in channels:
        channel.advance(end)


def _times(start: int, end: int, per_second: int) -> list[int]:
    """Return the times of all items, computed from `start`, so that frames and captions agree to the nanosecond."""
    count = (end - start) * per_second // NANOS_PER_SECOND
    return [start + number * NANOS_PER_SECOND // per_second for number in range(count)]


def _put_all(
    channel: st.Channel, times: Sequence[int], delay_nanos: int, payload_bytes: int, lasting: bool,
    interrupted: threading.Event,
) -> None:  # fmt: skip
    ends = [*times[1:], times[-1] + FRAME_NANOS]
    for at, end in zip(times, ends, strict=True):
        if interrupted.wait(max(0, at + delay_nanos - time.time_ns()) / NANOS_PER_SECOND):
            return
        channel.put(bytes(payload_bytes), time=at, duration=f"{end - at}ns" if lasting else None)


# Used in a consumer's process: its connection, and the things that it reads.
_prepared: list[tuple[st.Connection, st.Channel | st.GroupChannel]] = []


def prepare(namespace: NetworkNamespace | None, address: str, name: str, grouped: bool) -> None:
    """Enter the namespace, if there is one, and prepare to read the channel there."""
    if namespace is not None:
        namespace.enter()
    rt = st.connect(address)
    _prepared.append((rt, rt.group(GROUP)[name] if grouped else rt.channel(name, create=False)))


def consume(start: int, end: int) -> list[Receipt]:
    """Read all new items of the channel as soon as they are visible, until no more can come."""
    receipts: list[Receipt] = []
    rt, source = _prepared.pop()
    with rt:
        last_time = start - 1
        while items := source.get(last_time, end, bounds="()", match="start", timeout=PATIENCE_SECONDS):
            received = time.time_ns()
            receipts += [Receipt(item.time, received) for item in items]
            last_time = items[-1].time
    return receipts
