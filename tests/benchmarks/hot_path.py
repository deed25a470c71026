"""Put, newest, interval get and subscribe over gRPC, compared with bare grpcio that moves the same bytes.

    python -m tests.benchmarks.hot_path [--seconds 1.0] [--rounds 5]

One host process, one bare server process; clients are synchronous, in this process. Rounds of the product and rounds of
the bare server take turns. Every figure is the median of its rounds. The ratio also has its spread (min to max).
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.transports.grpc_options import CHANNEL_OPTIONS
from tests.benchmarks.bare_server import REQUEST
from tests.support.cluster import running_cluster
from tests.support.processes import started

SIZES = (64, 18_000, 300_000)
INTERVAL_ITEMS = {64: 1000, 18_000: 200, 300_000: 20}
RUN_ITEMS = {64: 256, 18_000: 3, 300_000: 1}
RUNS = 8  # on their way from a producer to a subscriber, before the first of them is read
# more items than are ever under way: a reader would wait for ever for an item that was collected before the read
CHANNEL_ITEMS = 4096


@dataclass(frozen=True)
class PathRate:
    """Items per second, and the median time of one operation in microseconds."""

    items_per_second: float
    p50_us: float


def measure(operation: Callable[[], int], seconds: float) -> PathRate:
    """Repeat `operation`, which says how many items it moved, for `seconds`."""
    durations, items = [], 0
    end = time.perf_counter() + seconds
    started = now = time.perf_counter()
    while now < end:
        items += operation()
        after = time.perf_counter()
        durations.append(after - now)
        now = after
    return PathRate(items / (now - started), statistics.median(durations) * 1e6)


class BareClient:
    """The calls of the bare server on open streams."""

    def __init__(self, target: str) -> None:
        self._channel = grpc.insecure_channel(target, options=CHANNEL_OPTIONS)

    def pingpong(self, method: str) -> Callable[[bytes, int], list[bytes]]:
        requests: SimpleQueue[bytes | None] = SimpleQueue()
        call = self._channel.stream_stream(f"/bare/{method}")(iter(requests.get, None))

        def exchange(request: bytes, responses: int = 1) -> list[bytes]:
            requests.put(request)
            return [next(call) for _ in range(responses)]

        return exchange

    def relay(self) -> tuple[Callable[[bytes], None], Iterator[bytes]]:
        out = self._channel.unary_stream("/bare/Out")(b"")
        out.initial_metadata()
        requests: SimpleQueue[bytes | None] = SimpleQueue()
        acks = self._channel.stream_stream("/bare/In")(iter(requests.get, None))

        def send(message: bytes) -> None:
            requests.put(message)
            next(acks)

        return send, out


@contextmanager
def bare_server() -> Iterator[str]:
    command = [sys.executable, "-m", "tests.benchmarks.bare_server"]
    with started(command) as process:
        assert process.stdout is not None
        yield f"127.0.0.1:{process.stdout.readline().strip()}"


def put_one(channel: st.Channel, bare: BareClient, size: int) -> tuple[Callable[[], int], Callable[[], int]]:
    payload, ack = bytes(size), bare.pingpong("Ack")
    return lambda: bool(channel.put(payload)), lambda: len(ack(payload, 1))


def newest(channel: st.Channel, bare: BareClient, size: int) -> tuple[Callable[[], int], Callable[[], int]]:
    fetch, request = bare.pingpong("Fetch"), REQUEST.pack(1, 1, size)
    channel.put(bytes(size))
    return lambda: channel.newest() is not None, lambda: len(fetch(request, 1))


def interval(channel: st.Channel, bare: BareClient, size: int) -> tuple[Callable[[], int], Callable[[], int]]:
    """Get some items in one get. On the bare server: the same bytes in messages of up to 1 MiB."""
    count = INTERVAL_ITEMS[size]
    with channel.producer() as producer:
        for _ in range(count):
            producer.put(bytes(size))
    per_message = max(1, min(count, (1 << 20) // size))
    messages = -(-count // per_message)
    fetch, request = bare.pingpong("Fetch"), REQUEST.pack(messages, per_message, size)

    def get() -> int:
        items = channel.get(st.OLDEST, st.NEWEST, limit=count)
        return sum(len(item.payload or b"") == size for item in items)

    def fetch_all() -> int:
        fetch(request, messages)
        return count

    return get, fetch_all


def subscribe(channel: st.Channel, bare: BareClient, size: int) -> tuple[Callable[[], int], Callable[[], int]]:
    """A pipelined producer sends RUNS runs to a subscriber. The bare server relays as many messages of the same
    bytes.
    """
    payload, count = bytes(size), RUN_ITEMS[size]
    producer, received = channel.producer(), channel.subscribe()
    send, out = bare.relay()
    message, messages = bytes(size * count), RUNS

    def through() -> int:
        for _ in range(count * messages):
            producer.put(payload)
        producer.flush()
        for _ in range(count * messages):
            next(received)
        return count * messages

    def relayed() -> int:
        for _ in range(messages):
            send(message)
        for _ in range(messages):
            next(out)
        return count * messages

    return through, relayed


OPERATIONS: dict[str, Callable[..., Any]] = {
    "put, one acked": put_one,
    "newest": newest,
    "interval get": interval,
    "put to subscriber": subscribe,
}


def compare(ours: Callable[[], int], bare: Callable[[], int], seconds: float, rounds: int) -> str:
    pairs = []
    measure(ours, seconds / 5)
    measure(bare, seconds / 5)
    for _ in range(rounds):
        pairs.append((measure(ours, seconds), measure(bare, seconds)))
    mine = [one for one, _ in pairs]
    theirs = [one for _, one in pairs]
    ratios = [one.items_per_second / other.items_per_second for one, other in pairs]
    rates = [statistics.median(one.items_per_second for one in of) for of in (mine, theirs)]
    times = [statistics.median(one.p50_us for one in of) for of in (mine, theirs)]
    return (
        f"{rates[0]:12,.0f}  {times[0]:9,.0f}  {rates[1]:12,.0f}  {times[1]:9,.0f}  "
        f"{statistics.median(ratios):5.2f}  ({min(ratios):.2f} to {max(ratios):.2f})"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    print(f"{'':17}{'bytes':>8}  {'items/s':>12}  {'p50 us':>9}  {'bare items/s':>12}  {'p50 us':>9}  ratio")
    with ExitStack() as stack:
        cluster = stack.enter_context(running_cluster(hosts=1, supernodes=1))
        bare = BareClient(stack.enter_context(bare_server()))
        rt = stack.enter_context(st.connect(cluster.address))
        for name, prepare in OPERATIONS.items():
            for size in SIZES:
                channel = rt.channel(f"bench/{list(OPERATIONS).index(name)}/{size}", max_items=CHANNEL_ITEMS)
                row = compare(*prepare(channel, bare, size), arguments.seconds, arguments.rounds)
                print(f"{name:17}{size:8}  {row}", flush=True)


if __name__ == "__main__":
    main()
