"""Puts over a path: single items of the client, runs of any producer, and the line of runs that wait for room."""

from __future__ import annotations

import itertools
from collections import defaultdict
from typing import Any

import stampede_rt as st
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import Offer
from tests.oracle import Ack, Item, OracleRetries, RefusedItem, put_run
from tests.property.paths.path_and_oracle import SteeredHost
from tests.property.paths.reads import PathReads
from tests.property.paths.surfaces import Surface
from tests.property.paths.values import OracleRun, Run

FULL = "CHANNEL_FULL"


class PathPuts(PathReads):
    """`PathReads`, with puts."""

    def __init__(self, surface: Surface, host: SteeredHost, policy: Policy) -> None:
        super().__init__(surface, host, policy)
        self.sent: list[Run] = []
        self._retries = OracleRetries()
        self._numbers: defaultdict[int, int] = defaultdict(lambda: 1)
        self._marks = itertools.count(1)

    def put_one(self, who: int, time: int | None, duration: int | None, length: int, timeout: float | None) -> None:
        """Put an item by one of the clients. With no timeout, a put that has to wait stays in line."""
        column = None if duration is None else [duration]
        offer = Offer(times=None if time is None else [time], durations=column, lengths=[length])
        run = Run(offer, [self._payload(length)], waits=timeout is None)
        fields = {"time": time, "duration": duration, "timeout": timeout}
        # The puts of one handle wait for each other. A new handle knows whether puts may wait in the channel; an older
        # one may first try without a wait, so that a put is refused twice.
        handle = self.handles[who] if timeout == 0 else self.open(who)
        self._put(run, lambda: handle.put(run.payloads[0], **fields))

    def put_run(self, offer: Offer, producer_id: int, *, waits: bool) -> None:
        """Put a run under the producer's next numbers."""
        first_number = self._numbers[producer_id]
        self._numbers[producer_id] += len(offer.lengths)
        self._send(Run(offer, [self._payload(length) for length in offer.lengths], producer_id, first_number, waits))

    def put_again(self, run: Run) -> None:
        """Repeat a run, as a producer that does not know the outcome."""
        self._send(run)

    def put_overlapping(self, former: Run) -> None:
        """Put a new item and some earlier items under the numbers of the earlier ones, as a producer with a defect
        does.
        """
        lengths = [*former.offer.lengths, 8]
        payloads = [self._payload(length) for length in lengths]
        offer = Offer(times=None, durations=None, lengths=lengths)
        self._send(Run(offer, payloads, former.producer_id, former.first_number))

    def break_stream(self, entry: OracleRun) -> None:
        """Break the stream of a waiting run.

        Its accepted items stay, and the host knows them when the run is repeated.
        """
        self.surface.break_stream(entry.run)
        self.line.remove(entry)
        self._remember(entry)
        self.until(lambda stats: bool(stats.waiting_puts <= len(self.line)))
        self.advance_line()
        self.settle()

    def _send(self, run: Run) -> None:
        if run.producer_id and run not in self.sent:
            self.sent.append(run)
        self._put(run, lambda: self.surface.put_run(self.channel, run))

    def _payload(self, length: int) -> bytes:
        """Bytes that no other item has, as far as the length allows."""
        return (next(self._marks).to_bytes(4, "big") * (length // 4 + 1))[:length]

    def _put(self, run: Run, call: Any) -> None:
        entry = OracleRun(run, run.offer)
        expected = self._judge(entry)
        if expected is not None:
            _same(self.outcome(call), expected, run)
        else:
            self.line.append(entry)
            entry.started = self.surface.start(call)
            self.until(lambda stats: bool(stats.waiting_puts == len(self.line)))
        self.settle()

    # --- the oracle's side

    def _judge(self, entry: OracleRun) -> Ack | RefusedItem | None:
        """The answer to the run's producer; None: the run has to wait."""
        known = self._known(entry)
        if known is not None:
            return known
        if not self.line and self._offer(entry):
            return self._answer(entry)
        if entry.run.waits:
            return None
        return self._refuse_rest(entry)

    def _refuse_rest(self, entry: OracleRun) -> Ack:
        self.oracle.rejected[FULL] += entry.refuse_rest(FULL)
        return self._answer(entry)

    def _known(self, entry: OracleRun) -> Ack | RefusedItem | None:
        """The former answer of the run; None: the run has no answer yet.

        If only its first items have verdicts, the run goes on with the others.
        """
        run = entry.run
        known = self._retries.find(run.producer_id, run.first_number, len(run.payloads), self.clock)
        if known is None or isinstance(known, RefusedItem):
            return known
        entry.resume(known.verdicts, self.clock)
        return entry.ack(known.judged_at) if known.is_whole else None

    def _offer(self, entry: OracleRun) -> bool:
        """Put the rest of the run, up to the first item that has to wait. Returns True if no item has to wait."""
        taken = put_run(self.oracle, entry.rest, self.clock)
        for verdict, payload in zip(taken.verdicts, entry.payloads_left, strict=False):
            if isinstance(verdict, Item):
                self.payloads[verdict.seq] = payload
        entry.verdicts += taken.verdicts
        if any(isinstance(verdict, Item) for verdict in taken.verdicts):
            self.announce()
        if taken.waits is not None:
            entry.rest = entry.rest.rest(len(taken.verdicts), self.clock)
            if any(isinstance(verdict, Item) for verdict in taken.verdicts):
                self._remember(entry)
        return taken.waits is None

    def _answer(self, entry: OracleRun) -> Ack:
        self._remember(entry)
        return entry.ack(self.clock)

    def _remember(self, entry: OracleRun) -> None:
        run = entry.run
        self._retries.record(run.producer_id, run.first_number, len(run.payloads), entry.verdicts, self.clock)

    def advance_line(self) -> None:
        """Put the waiting runs again, the first in line first, because there may be room now."""
        while self.line:
            head = self.line[0]
            expected = self._known(head)
            if expected is None:
                if not self._offer(head):
                    return
                expected = self._answer(head)
            self.line.pop(0)
            assert head.started is not None
            _same(head.started.outcome(), expected, head.run)


def _same(outcome: Any, expected: Ack | RefusedItem, run: Run) -> None:
    """Check the outcome of a put: the ack of a run, the item that the client returned, or a refusal."""
    if isinstance(expected, RefusedItem):
        assert isinstance(outcome, st.StampedeError), outcome
        assert outcome.reason == expected.reason
    elif run.first_number:
        assert outcome == expected
    elif expected.refused:
        assert isinstance(outcome, st.StampedeError), outcome
        assert {0: outcome.reason} == expected.refused
    else:
        seq, stamped = expected.first
        time = stamped if run.offer.times is None else run.offer.times[0]
        duration = None if run.offer.durations is None else run.offer.durations[0]
        assert isinstance(outcome, st.Item), outcome
        facts = (outcome.time, outcome.seq, outcome.duration, outcome.payload)
        assert facts == (time, seq, duration, run.payloads[0])
