"""Checks the runs that a host sends. A defective or hostile host must not crash the reader, nor fill its memory."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import item_pb2

RUN_ITEMS_MAX = 256
RESPONSE_ITEMS_MAX = 2**20 // 12  # a response has at most 1 MiB, and an item at least a time and a length: 12 bytes
_SEQ_END = 2**64  # all seqs are lower


def check_delivered(run: item_pb2.ItemRun, *, payloads: bool) -> int:
    """Return the number of items of a delivered run. `payloads`: whether the run should have payloads.

    Raises StampedeError if the columns disagree.
    """
    columns = run.payload_length_bytes, run.time_unix_nano, run.duration_nanos
    return check_columns(*columns, run.first_seq, len(run.payloads) if payloads else None)


def check_columns(
    lengths: Sequence[int], times: Sequence[int], durations: Sequence[int], first_seq: int, payload_bytes: int | None
) -> int:
    """Return the number of items of a run with these columns. `payload_bytes` None: it should have no payloads.

    Raises StampedeError if the columns disagree.
    """
    items = len(lengths)
    if not 0 < items <= RUN_ITEMS_MAX or len(times) != items or len(durations) not in (0, items):
        raise malformed(f"{items} lengths, {len(times)} times and {len(durations)} durations")
    if payload_bytes is not None and sum(lengths) != payload_bytes:
        raise malformed(f"lengths of {sum(lengths)} bytes in all and payloads of {payload_bytes} bytes")
    if first_seq + items > _SEQ_END:
        raise malformed(f"{items} items from seq {first_seq} on")
    return items


class ItemCount:
    """Counts the items of the responses to one request, before the client decodes them.

    `limit`: the greatest number of items that the request asks for. 0 means no limit.
    """

    def __init__(self, limit: int = 0) -> None:
        self._limit = limit
        self._items = 0

    def add(self, runs: Iterable[item_pb2.ItemRun]) -> None:
        """Count the items of one response. Raises StampedeError if the host sent more items than it may."""
        self.add_items(sum(len(run.payload_length_bytes) for run in runs))

    def add_items(self, items: int) -> None:
        """Count the items of one response, as `add`."""
        self._items += items
        if items > RESPONSE_ITEMS_MAX:
            raise _too_many(items, RESPONSE_ITEMS_MAX, "one response has")
        if self._limit and self._items > self._limit:
            raise _too_many(self._items, self._limit, "the request asked for")


def check_granted(items: int, granted: int) -> None:
    """Raise StampedeError if a host sent more messages of a queue than the reader granted."""
    if items > granted:
        raise _too_many(items, granted, "the reader granted")


def malformed(what: str) -> StampedeError:
    """Return the error for a run that a host sent. `what` names the fault of its columns."""
    return StampedeError(f"a host sent a run with {what}; it is defective, or not of this product: replace it")


def _too_many(items: int, most: int, whose: str) -> StampedeError:
    return StampedeError(
        f"a host sent {items} items, and {whose} {most} at most; it is defective, or not of this product: replace it"
    )
