"""The cost for a host to count the work of calls for their callers (decisions 0130 and 0139).

    python -m tests.benchmarks.charged_calls [--calls 400] [--rounds 60]

One good client puts and gets, one call after the other, on a thread of its own. In each second round the host counts
nothing, as if the caller were a service of the cluster. The figures are medians of the processor time of the host's
event loop.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import Any

import grpc

from stampede_rt.transports.grpc_options import CHANNEL_OPTIONS
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_runtime.access import control
from stampede_rt_runtime.main import run_loop
from stampede_rt_runtime.quotas import working
from tests.support.channel_host.rig import OpenedChannel, run_of, running_host

SERVICE = "/stampede_rt.v1.ChannelService"
PAYLOAD = b"x" * 100


@dataclass
class CallTimes:
    """The processor time of one call in microseconds, by round."""

    counted_us: list[float] = field(default_factory=list)
    uncounted_us: list[float] = field(default_factory=list)
    steps: float = 0.0

    def text(self, name: str) -> str:
        """A row of the table."""
        counted, uncounted = statistics.median(self.counted_us), statistics.median(self.uncounted_us)
        pairs = zip(self.counted_us, self.uncounted_us, strict=True)
        more = statistics.median(one - other for one, other in pairs)
        return (
            f"{name:8} {uncounted:10.1f} {counted:10.1f} {more:8.1f} {100 * more / uncounted:6.1f} % "
            f"{self.steps:6.1f} {more / self.steps:8.2f}"
        )


class Callers:
    """Decides whether the caller of the streams that open next has quotas, so that the host counts its work."""

    has_quotas = True

    def subject_of(self, caller: object, peer: str) -> str | None:
        """See `quotas.subjects`."""
        return "good" if self.has_quotas else None


@contextmanager
def callers() -> Iterator[Callers]:
    """Callers that all have quotas, or callers without quotas."""
    found, subject_of = Callers(), control.subject_of
    control.subject_of = found.subject_of
    try:
        yield found
    finally:
        control.subject_of = subject_of


@contextmanager
def counted_steps() -> Iterator[list[int]]:
    """A list with the number of steps that are counted."""
    steps, charged = [0], working._ChargedCoroutine.send

    def send(self: Any, value: Any) -> Any:
        steps[0] += 1
        return charged(self, value)

    working._ChargedCoroutine.send = send  # type: ignore[method-assign]
    try:
        yield steps
    finally:
        working._ChargedCoroutine.send = charged  # type: ignore[method-assign]


def calls_of(channel: OpenedChannel, target: str, method: str, number: int) -> Callable[[], None]:
    """A function that makes the given number of calls on a new stream, one after the other."""
    known = {"channel_id": channel.channel_id, "epoch": channel.epoch}
    put = pb.PutRequest(**known, puts=[run_of(PAYLOAD)]).SerializeToString()

    def request(call_id: int) -> bytes:
        return put if method == "Put" else channel.newest_request(call_id).SerializeToString()

    def make() -> None:
        requests: SimpleQueue[bytes | None] = SimpleQueue()
        with grpc.insecure_channel(target, options=CHANNEL_OPTIONS) as connection:
            call = connection.stream_stream(f"{SERVICE}/{method}")(iter(requests.get, None))
            for call_id in range(1, number + 1):
                requests.put(request(call_id))
                next(call)
            requests.put(None)
            assert not [*call], "each call has one response"

    return make


async def cpu_us(work: Callable[[], None], number: int) -> float:
    """The processor time of this thread for one of the calls."""
    began_s = time.thread_time()
    await asyncio.to_thread(work)
    return (time.thread_time() - began_s) / number * 1e6


async def measure(method: str, number: int, rounds: int) -> CallTimes:
    """Measure the rounds. The host counts the calls of every second round."""
    found = CallTimes()
    with callers() as all_callers:
        async with running_host() as rig:
            channel = await rig.open()
            await channel.put(run_of(PAYLOAD))
            work = calls_of(channel, rig.target, method, number)
            with counted_steps() as steps:
                await cpu_us(work, number)
            found.steps = steps[0] / number
            for _ in range(rounds):
                for all_callers.has_quotas, times_us in ((True, found.counted_us), (False, found.uncounted_us)):
                    times_us.append(await cpu_us(work, number))
    return found


async def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.charged_calls", description=__doc__)
    parser.add_argument("--calls", type=int, default=400, help="calls of a round (default: 400)")
    parser.add_argument("--rounds", type=int, default=60, help="rounds of each kind (default: 60)")
    options = parser.parse_args()
    print(f"{'us':8} {'uncounted':>10} {'counted':>10} {'more':>8} {'':>8} {'steps':>6} {'a step':>8}")
    for name, method in (("put", "Put"), ("newest", "Get")):
        print((await measure(method, options.calls, options.rounds)).text(name), flush=True)


if __name__ == "__main__":
    run_loop(main())
