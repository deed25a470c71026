"""grpcio without our code, in its fastest form: messages of 1 MiB as plain bytes, streams that stay open.

Clients are blocking. asyncio clients take about as long for a round trip.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import grpc
import grpc.experimental

from stampede_rt_bench.limits.framing import ONE_READER, REQUEST
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, Step, WorkloadNeeds
from stampede_rt_bench.workloads.processes import server

MESSAGE_BYTES_MAX = 64 << 20
OPTIONS = [
    ("grpc.max_receive_message_length", MESSAGE_BYTES_MAX),
    ("grpc.max_send_message_length", MESSAGE_BYTES_MAX),
    (grpc.experimental.ChannelOptions.SingleThreadedUnaryStream, 1),
]
LOOK_SECONDS = 0.1


@dataclass(frozen=True)
class BareGrpc:
    """A relay of messages in a separate process."""

    name: str = "bare gRPC"

    @property
    def unsupported(self) -> Mapping[str, str]:
        """Return the kinds of workload that this system cannot run: frames, because it serves one reader only."""
        return {"frames": ONE_READER}

    def unavailable_because(self) -> str | None:
        """Return None, because the client of Stampede RT needs grpcio anyway."""
        return None

    @contextmanager
    def served(self, needs: WorkloadNeeds) -> Iterator[RunningServer]:
        """Run the relay in a new process for the duration of the context."""
        with tempfile.TemporaryDirectory(prefix="stampede-bench-") as folder:
            ready = Path(folder, "address")
            command = [sys.executable, "-P", "-m", "stampede_rt_bench.limits.grpc_server", str(ready)]
            with server(command, Path(folder, "log"), ready.exists) as pid:
                yield RunningServer(address=ready.read_text(), pids=[pid])

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> GrpcClient:
        """Return a client with a new gRPC channel."""
        return GrpcClient(served.address, needs)


class GrpcClient:
    """A client that uses open streams of one blocking gRPC channel."""

    def __init__(self, address: str, needs: WorkloadNeeds) -> None:
        self._needs = needs
        self._channel: Any = grpc.insecure_channel(address, options=OPTIONS)

    def put(self, payloads: Iterator[bytes]) -> None:
        """Send each payload as a message, and wait for an answer of 24 bytes, on one stream."""
        exchange = self._exchange("Ack")
        for payload in payloads:
            exchange(payload)

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Send a small message, and wait for one item."""
        self.interval(turns, receiver)

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Send a small message, and wait for the bytes of all items in one message."""
        exchange = self._exchange("Fetch")
        for items in turns:
            receiver.take_block(items, exchange(REQUEST.pack(items, self._needs.item_bytes)))

    def publish(self, steps: Iterator[Step]) -> None:
        """Send the payloads of each step, joined, as one message. gRPC's flow control bounds the bytes under way."""
        self._channel.stream_unary("/bare/In")(_messages(steps))

    def subscribe(self, receiver: Receiver) -> None:
        """Take whole messages until the run ends."""
        out = self._channel.unary_stream("/bare/Out")(REQUEST.pack(0, 0))
        messages = iter(out)
        next(messages)
        receiver.ready()
        for message in messages:
            if not message:  # the server sends a sign of life ten times a second
                if receiver.ended():
                    break
                continue
            receiver.take_block(len(message) // self._needs.item_bytes, message)
            if receiver.ended():
                break
        out.cancel()

    def close(self) -> None:
        """End the connection."""
        self._channel.close()

    def _exchange(self, method: str) -> Callable[[bytes], bytes]:
        requests: SimpleQueue[bytes | None] = SimpleQueue()
        call = self._channel.stream_stream(f"/bare/{method}")(iter(requests.get, None))

        def exchange(request: bytes) -> bytes:
            requests.put(request)
            answer: bytes = next(call)
            return answer

        return exchange


def _messages(steps: Iterator[Step]) -> Iterator[bytes]:
    for step in steps:
        if isinstance(step, float):
            time.sleep(step)
        else:
            yield step[0] if len(step) == 1 else b"".join(step)
