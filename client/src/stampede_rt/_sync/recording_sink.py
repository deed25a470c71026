# Generated from ../_async by tools/generate.py; do not edit.
"""The file of a recording, for the channels that are recorded at the same time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

from stampede_rt._sync.recording_stream import RecordedBatch
from stampede_rt.errors import FileError
from stampede_rt.files.entries import FileAdvance, Topic, encoding_of, item_entry
from stampede_rt.files.tally import ChannelTally
from stampede_rt.files.writing import FileWriter
from stampede_rt.transports.concurrency_sync import Signal, StepLock, in_thread
from stampede_rt.values.seq_starts import given_between

ENCODINGS_MAX = 16  # the most topics of one channel; items with further content types share one more
Metadata = tuple[tuple[str, str], ...]
FLUSH_S = 1.0  # the longest time for which an item waits for the end of its chunk


class RecordingSink:
    """Writes batches, one at a time, on another thread than the event loop. `failed` is set when a write has failed."""

    def __init__(self, writer: FileWriter) -> None:
        self.writer = writer
        self._turns = StepLock()
        self._mutex = threading.Lock()  # because the write of a cancelled task continues
        self._topics: dict[tuple[str, int], dict[str, Topic]] = {}
        self.failed = Signal()
        self.error: FileError | None = None

    def do(self, operation: Callable[[], None]) -> None:
        """Run `operation` on the file, after all earlier ones. Raises FileError."""
        try:
            with self._turns:
                in_thread(partial(self._alone, operation))
        except FileError as error:
            self.error = self.error or error
            self.failed.set()
            raise

    def _alone(self, operation: Callable[[], None]) -> None:
        with self._mutex:
            operation()

    def write(self, tally: ChannelTally, batch: RecordedBatch, metadata: Metadata) -> None:
        """Write a batch of one channel, and count it. Raises FileError."""
        self.do(partial(self._write, tally, batch, metadata))

    def _write(self, tally: ChannelTally, batch: RecordedBatch, metadata: Metadata) -> None:
        if tally.is_ended:  # the recording has ended meanwhile, and its gaps name this batch
            return
        for gap in batch.gaps:
            self.writer.add_gap(gap)
            tally.add_gap(gap)
        self.writer.add(item_entry(self._topic(tally, item.content_type, metadata), item) for item in batch.items)
        tally.add(batch.items)
        if batch.read_to is not None:
            tally.written_to = batch.read_to
        self._write_advance(tally, batch.advance)

    def _write_advance(self, tally: ChannelTally, advance: tuple[int, int] | None) -> None:
        if advance is not None and (tally.advance is None or advance[0] > tally.advance):
            tally.advance = advance[0]
            self.writer.add_advance(FileAdvance(tally.channel, tally.incarnation, *advance))

    def end_channel(self, tally: ChannelTally, accepted_to: int | None, advance: int | None) -> None:
        """End a channel at the last seq that its host has accepted; None: at the last written seq.

        Writes the gaps that remain. A batch that comes later is not written. Raises FileError.
        """
        self.do(partial(self._end_channel, tally, accepted_to, advance))

    def _end_channel(self, tally: ChannelTally, accepted_to: int | None, advance: int | None) -> None:
        last = max(tally.written_to, tally.written_to if accepted_to is None else accepted_to)
        for gap in tally.ends(last, tally.written_to):
            self.writer.add_gap(gap)
            tally.add_gap(gap)
        if advance is not None and not given_between(tally.written_to + 1, last + 1):
            self._write_advance(tally, (advance, last))
        tally.is_ended = True

    def _topic(self, tally: ChannelTally, content_type: str, metadata: Metadata) -> Topic:
        topics = self._topics.setdefault((tally.channel, tally.incarnation), {})
        found = topics.get(content_type)
        if found is None:
            encoding = encoding_of(content_type if len(topics) < ENCODINGS_MAX else "")
            found = Topic(tally.channel, encoding, tally.incarnation, None, metadata)
            if len(topics) < ENCODINGS_MAX:
                topics[content_type] = found
        return found
