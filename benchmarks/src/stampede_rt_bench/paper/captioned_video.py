"""The streams of the paper's Figure 7: 30 frames and 2 captions a second, each with a host and a consumer of its own.

The producer's two threads, both hosts and both consumers are told nothing of each other.
"""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Literal, NamedTuple

import stampede_rt as st
from stampede_rt.timeline import MAX_INSTANT
from stampede_rt_bench.clusters import running
from stampede_rt_local.namespaces import Network

SECONDS = 8
LEAD_SECONDS = 3
NANOS_PER_SECOND, NANOS_PER_MS = 1_000_000_000, 1_000_000
FRAMES_PER_SECOND, CAPTIONS_PER_SECOND = 30, 2
FRAME_NANOS = NANOS_PER_SECOND // FRAMES_PER_SECOND
FRAMES_PER_CAPTION = FRAMES_PER_SECOND // CAPTIONS_PER_SECOND
FRAME_BYTES, CAPTION_BYTES = 18_000, 512
DECODING_NANOS = 10 * NANOS_PER_MS
VIDEO, CAPTIONS, GROUP = "bench/video", "bench/captions", "bench/skew"
MACHINES = 4  # for the two hosts and the two consumers


class Receipt(NamedTuple):
    """An item's time, and when the get returned that brought it."""

    time: int
    received: int


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Whether consumers read through a group, its bound (with `end` frames have durations), and when captions come.

    Captions are `captions_after_nanos` after the frames whose beginning they share, and known `decoding_nanos` later.
    """

    name: str
    grouped: bool = True
    bound: Literal["start", "end"] = "start"
    captions_after_nanos: int = 0
    decoding_nanos: int = DECODING_NANOS


def play(setting: Setting, network: Network | None) -> tuple[list[Receipt], list[Receipt]]:
    """What the consumers of frames and captions got, and when. Blocks for some twelve seconds.

    On a `network` of MACHINES places every host and consumer is in one of its own.
    """
    context = multiprocessing.get_context("spawn")
    with running(hosts=2, network=network) as address, st.connect(address) as rt, ExitStack() as pools:
        hosts = [host.name for host in rt.hosts()]
        channels = [
            rt.channel(name, max_age="30s", host=host) for name, host in zip((VIDEO, CAPTIONS), hosts, strict=True)
        ]
        rt.group(GROUP, channels, reference="oldest", bound=setting.bound)
        start = time.time_ns() + LEAD_SECONDS * NANOS_PER_SECOND
        until = start + SECONDS * NANOS_PER_SECOND
        consumers = []
        for name, enter in zip((VIDEO, CAPTIONS), _ways_in(network), strict=True):
            pool = pools.enter_context(context.Pool(1, initializer=enter))
            consumers.append(pool.apply_async(consume, (address, name, setting.grouped, start, until)))
        _produce(channels, setting, start)
        frames, captions = (consumer.get(timeout=SECONDS + 30) for consumer in consumers)
    return frames, captions


def _ways_in(network: Network | None) -> Sequence[Callable[[], None] | None]:
    """How each consumer comes to its place; hosts have the first ones."""
    return [None, None] if network is None else [place.enter for place in network.places[2:MACHINES]]


def _produce(channels: Sequence[st.Channel], setting: Setting, start: int) -> None:
    """Two threads, as in the paper: frames and captions when they are due."""
    video, captions = channels
    frames = _times(start, FRAMES_PER_SECOND)
    texts = [at + setting.captions_after_nanos for at in _times(start, CAPTIONS_PER_SECOND)]
    threads = [
        threading.Thread(target=_put_all, args=(video, frames, 0, FRAME_BYTES, setting.bound == "end")),
        threading.Thread(target=_put_all, args=(captions, texts, setting.decoding_nanos, CAPTION_BYTES, False)),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _times(start: int, per_second: int) -> list[int]:
    """Every frame that begins with a caption does so to the nanosecond: periods are not added up."""
    return [start + number * NANOS_PER_SECOND // per_second for number in range(SECONDS * per_second)]


def _put_all(channel: st.Channel, times: Sequence[int], delay_nanos: int, payload_bytes: int, lasting: bool) -> None:
    ends = [*times[1:], times[-1] + FRAME_NANOS]
    for at, end in zip(times, ends, strict=True):
        time.sleep(max(0, at + delay_nanos - time.time_ns()) / NANOS_PER_SECOND)
        channel.put(bytes(payload_bytes), time=at, duration=f"{end - at}ns" if lasting else None)


def consume(address: str, name: str, grouped: bool, start: int, until: int) -> list[Receipt]:
    """In a process of its own: everything of a channel as it can be had, newer than what is there."""
    receipts: list[Receipt] = []
    with st.connect(address) as rt:
        source: st.Channel | st.GroupChannel = rt.group(GROUP)[name] if grouped else rt.channel(name, create=False)
        behind = start - 1
        while time.time_ns() < until:
            items = source.get(behind, MAX_INSTANT, bounds="(]", match="start", timeout=0.5)
            received = time.time_ns()
            receipts += [Receipt(item.time, received) for item in items]
            behind = items[-1].time if items else behind
    return receipts
