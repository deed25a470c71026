"""Calls to the owner of a core channel that may have to wait."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import stampede_rt as st
from stampede_rt_channel_host.core.channel import PutOutcome
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunProgress
from tests.oracle import Ack
from tests.property.paths.values import Run


class Call:
    """A call that may have to wait until `finish` gives its outcome."""

    def __init__(self, give_up: Callable[[], None]) -> None:
        self._give_up = give_up
        self._outcomes: list[Any] = []
        self._convert: Callable[[Any], Any] = lambda outcome: outcome

    def then(self, convert: Callable[[Any], Any]) -> Call:
        """The same call, with its result converted. An error stays an error."""
        self._convert = convert
        return self

    def is_done(self) -> bool:
        return bool(self._outcomes)

    def finish(self, outcome: Any) -> None:
        assert not self._outcomes, "a call ends once"
        self._outcomes.append(outcome)

    def outcome(self) -> Any:
        """The result or the StampedeError."""
        assert self._outcomes, "the call ought to be done by now"
        (outcome,) = self._outcomes
        return outcome if isinstance(outcome, st.StampedeError) else self._convert(outcome)

    def run_to_end(self) -> Any:
        """The outcome of a call that must not wait any longer."""
        if not self.is_done():
            self._give_up()
        return self.outcome()


class WaitingPut:
    """A run and the verdicts on its items so far.

    `retry_at`: the instant at which time makes room for the other items.
    """

    def __init__(self, run: Run, call: Call) -> None:
        self.run, self.call = run, call
        self.offer = run.offer
        self.retry_at: int | None = None
        self.progress = RunProgress(len(run.payloads))

    @property
    def payloads(self) -> Sequence[bytes]:
        return self.run.payloads[self.progress.judged_items :]

    def take_outcome(self, outcome: PutOutcome, now: int) -> bool:
        """Take over an outcome. Returns True if no item has to wait."""
        judged_items = self.progress.judged_items
        for one in outcome.rejections:
            self.progress.refuse(judged_items + one.index, one.error)
        self.progress.judged_items = len(self.run.payloads)
        if outcome.waiting is not None:
            self.offer, self.retry_at = self.offer.rest(outcome.waiting, now), outcome.retry_at
            self.progress.judged_items = judged_items + outcome.waiting
        return outcome.waiting is None

    def resume(self, known: RunOutcome, now: int) -> None:
        """Go on with a repeated run whose first items have verdicts."""
        judged_items = self.progress.judged_items
        if self.progress.resume(known) and not known.is_whole:
            self.offer = self.offer.rest(known.judged_items - judged_items, now)

    def fail(self, error: st.StampedeError, now: int) -> None:
        """Refuse the items without a verdict. If no item was accepted, refuse the run as a whole."""
        if not self.progress.accepted_any:
            self.call.finish(error)
        else:
            for position in range(self.progress.judged_items, len(self.run.payloads)):
                self.progress.refuse(position, error)
            self.call.finish(ack_of(self.progress.outcome(now)))


def ack_of(judged: RunOutcome) -> Ack:
    """The answer to the run's producer."""
    refused = {one.position: one.error.reason for one in judged.refusals}
    bounds = [*(part.position for part in judged.parts[1:]), judged.items]
    accepted = {}
    for part, bound in zip(judged.parts, bounds, strict=False):
        positions = (position for position in range(part.position, bound) if position not in refused)
        accepted |= {position: (seq, part.stamped_time) for seq, position in enumerate(positions, part.first_seq)}
    return Ack(accepted, refused, judged.time)
