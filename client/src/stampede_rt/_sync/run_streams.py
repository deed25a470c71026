# Generated from ../_async by tools/generate.py; do not edit.
"""The streams over which a producer puts its runs: over the wire, or by reference to the host of this process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol
from weakref import WeakMethod

from stampede_rt._sync.session import Session
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import StampedeError
from stampede_rt.transports.concurrency_sync import from_any_thread
from stampede_rt.transports.grpc_sync import PutDuplex
from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.wire.batching import NumberedRun
from stampede_rt.wire.put_frames import put_head, put_pieces, put_tail

OnAcks = Callable[[channel_pb.PutResponse], None]
OnEnd = Callable[[StampedeError], None]


class RunStream(Protocol):
    """An open stream of puts to one host."""

    def send(self, runs: Sequence[NumberedRun]) -> None:
        """Send runs without waiting. If the stream breaks, its `on_end` gets the reason."""
        ...

    def cancel(self) -> None:
        """End the stream."""
        ...


class EncodedRuns:
    """A RunStream over the wire."""

    def __init__(self, duplex: PutDuplex, head: bytes, tail: bytes) -> None:
        """`head` and `tail`: see `put_request`."""
        self._duplex, self._tail = duplex, tail
        duplex.send(head)

    def send(self, runs: Sequence[NumberedRun]) -> None:
        """Send the runs in one request."""
        self._duplex.send([piece for run in runs for piece in self._pieces(run)])

    def _pieces(self, run: NumberedRun) -> list[bytes]:
        return put_pieces(b"", run.first_number, run.encoded, tail=self._tail)

    def cancel(self) -> None:
        """End the stream."""
        self._duplex.cancel()


def open_run_stream(
    session: Session, binding: Binding, producer_id: int, ack: channel_pb2.Ack, on_acks: OnAcks, on_end: OnEnd
) -> RunStream:
    """Open a stream to the host of `binding`. The caller holds no lock that `on_acks` needs.

    `ack`: the condition for the acks. If the channel is at the host of this process, and takes runs by reference, the
    runs do not go over the wire.
    """
    here = session.here
    if here is not None and binding.target == here.target:
        callbacks = from_any_thread(on_acks), from_any_thread(on_end)
        stream = here.puts(binding.subject_id, binding.epoch, producer_id, ack, *callbacks)
        if stream is not None:
            return stream
    duplex = session.endpoints.to(binding.target).duplex(on_acks, on_end)
    return EncodedRuns(duplex, put_head(binding.subject_id, binding.epoch, producer_id), put_tail(ack))


def weakly(method: Callable[..., None]) -> Callable[..., None]:
    """Wrap `method` so that it does not keep its object alive. The wrapper does nothing when the object is gone."""
    reference = WeakMethod(method)

    def call(*arguments: Any) -> None:
        found = reference()
        if found is not None:
            found(*arguments)

    return call
