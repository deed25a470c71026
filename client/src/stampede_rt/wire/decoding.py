"""Decodes the runs that hosts send (`item.proto`) into Items."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

from google.protobuf.message import DecodeError

from stampede_rt.cluster.embedding import InProcessRun
from stampede_rt.v1 import item_pb2
from stampede_rt.values.answers import ABSENT
from stampede_rt.values.codecs import HandleCodec
from stampede_rt.values.columns import DecodedRun, ItemColumns, kept, span_end
from stampede_rt.values.model import Item
from stampede_rt.wire.delivered import ItemCount, check_columns, check_delivered, malformed
from stampede_rt.wire.long_answers import LongRun
from stampede_rt.wire.run_slices import sealed_parts

_NO_LABELS = item_pb2.ItemRun()


class ItemDecoder:
    """Turns delivered runs of one channel and incarnation into Items; `coding` decodes their values.

    `overlap_nanos`: an item with a duration may last for this time, even if later items come meanwhile.
    """

    def __init__(
        self,
        *,
        incarnation: int,
        content_type: str,
        payloads: bool,
        coding: HandleCodec | None = None,
        overlap_nanos: int = 0,
    ) -> None:
        self._overlap = overlap_nanos
        self._incarnation = incarnation
        self._content_type = content_type
        self._payloads = payloads
        self._make = coding.item if coding else None

    def decode(self, delivered: Sequence[item_pb2.DeliveredRun], *, backwards: bool = False) -> Sequence[Item]:
        """Return the items of runs that follow each other in time, such as the answer of a get.

        `backwards`: in reverse order. Raises StampedeError for a run whose columns disagree.
        """
        if not delivered:
            return []
        for one in delivered:
            check_delivered(one.run, payloads=self._payloads)
        if len(delivered) == 1 and len(delivered[0].run.payload_length_bytes) == 1:
            return [self._single(delivered[0].run, _next_time(delivered[0]))]
        return ItemColumns(
            [self._columns(one.run, _next_time(one)) for one in delivered],
            overlap=self._overlap,
            make=self._make,
            backwards=backwards,
        )

    def decode_here(self, runs: Sequence[InProcessRun], *, backwards: bool = False) -> Sequence[Item]:
        """Return the items of an answer of the host in this process.

        An item that this process put has the payload object of the put.
        """
        if len(runs) == 1 and runs[0].encoded is None:
            return [self._item_here(runs[0])]
        columns = [self._columns_here(run) for run in runs]
        if not columns:
            return []
        return ItemColumns(columns, overlap=self._overlap, make=self._make, backwards=backwards)

    def _item_here(self, run: InProcessRun) -> Item:
        fields = (
            run.time,
            span_end(run.time, run.duration, run.next_time, self._overlap),
            None if run.duration < 0 else run.duration,
            run.seq,
            run.payload,
            dict(run.attributes),
            run.content_type or self._content_type,
            run.length,
            self._incarnation,
        )
        return self._make(fields) if self._make else Item._make(fields)

    def _columns_here(self, run: InProcessRun) -> DecodedRun:
        if run.encoded is not None:
            return self._columns(item_pb2.ItemRun.FromString(run.encoded), run.next_time)
        return DecodedRun(
            times=(run.time,),
            durations=None if run.duration < 0 else (run.duration,),
            lengths=(run.length,),
            first_seq=run.seq,
            attributes=dict(run.attributes),
            content_type=run.content_type or self._content_type,
            incarnation=self._incarnation,
            payloads=run.payload,
            next_time=run.next_time,
        )

    def decode_each(self, delivered: Sequence[item_pb2.DeliveredRun]) -> list[Sequence[Item]]:
        """Return the items of each run of a response whose runs do not follow each other in time, as in a subscription.

        Raises StampedeError for a run whose columns disagree, and for more items than a response has.
        """
        ItemCount().add(one.run for one in delivered)
        return [self.decode((one,)) for one in delivered]

    def decode_long(self, runs: Sequence[LongRun]) -> list[Sequence[Item]]:
        """Return the items of each run of a long response, as `decode_each`. Copies the payloads."""
        decoded = [self._long_columns(one) for one in runs]
        ItemCount().add_items(sum(len(run.lengths) for run in decoded))
        return [ItemColumns([kept(run)], overlap=self._overlap, make=self._make) for run in decoded]

    def _long_columns(self, one: LongRun) -> DecodedRun:
        parts = sealed_parts(one.encoded)
        if parts is None:
            run = parse_run(one.encoded)
            check_delivered(run, payloads=self._payloads)
            return self._columns(run, one.next_time)
        first_seq, times, durations, lengths = parts.columns
        payloads = one.encoded[parts.payloads]
        check_columns(lengths, times, durations or (), first_seq, len(payloads) if self._payloads else None)
        labels = parse_run(parts.labels) if parts.labels else _NO_LABELS
        return DecodedRun(
            times=times,
            durations=durations,
            lengths=lengths,
            first_seq=first_seq,
            attributes=dict(labels.attributes),
            content_type=labels.content_type or self._content_type,
            incarnation=self._incarnation,
            payloads=payloads if self._payloads else None,
            next_time=one.next_time,
        )

    def _columns(self, run: item_pb2.ItemRun, next_time: int | None) -> DecodedRun:
        return DecodedRun(
            times=array("q", run.time_unix_nano),
            durations=array("q", run.duration_nanos) if run.duration_nanos else None,
            lengths=array("I", run.payload_length_bytes),
            first_seq=run.first_seq,
            attributes=dict(run.attributes),
            content_type=run.content_type or self._content_type,
            incarnation=self._incarnation,
            payloads=run.payloads if self._payloads else None,
            next_time=next_time,
        )

    def _single(self, run: item_pb2.ItemRun, next_time: int | None) -> Item:
        time = run.time_unix_nano[0]
        duration = run.duration_nanos[0] if run.duration_nanos else ABSENT
        fields = (
            time,
            span_end(time, duration, next_time, self._overlap),
            None if duration < 0 else duration,
            run.first_seq,
            run.payloads if self._payloads else None,
            dict(run.attributes) if run.attributes else {},
            run.content_type or self._content_type,
            run.payload_length_bytes[0],
            self._incarnation,
        )
        return self._make(fields) if self._make else Item._make(fields)


def parse_run(encoded: bytes | memoryview) -> item_pb2.ItemRun:
    """Return a run that a host sent. Raises StampedeError if it is damaged."""
    try:
        return item_pb2.ItemRun.FromString(encoded)  # type: ignore[arg-type]  # it takes views, too
    except DecodeError as error:
        raise malformed("bytes that are no valid message") from error


def _next_time(one: item_pb2.DeliveredRun) -> int | None:
    return one.next_time_unix_nano if one.HasField("next_time_unix_nano") else None
