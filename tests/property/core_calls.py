"""Calls to the owner of a core channel that may have to wait."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import stampede_rt as st
from stampede_rt_channel_host.core.channel import PutOutcome
from tests.oracle import Ack
from tests.property.path_values import Run


class Call:
    """One that may have to wait, until `finish` tells what came of it."""

    def __init__(self, give_up: Callable[[], None]) -> None:
        self._give_up = give_up
        self._outcomes: list[Any] = []
        self._convert: Callable[[Any], Any] = lambda outcome: outcome

    def then(self, convert: Callable[[Any], Any]) -> Call:
        """The same, with its result as `convert` makes it; an error stays one."""
        self._convert = convert
        return self

    def is_done(self) -> bool:
        return bool(self._outcomes)

    def finish(self, outcome: Any) -> None:
        assert not self._outcomes, "a call ends once"
        self._outcomes.append(outcome)

    def outcome(self) -> Any:
        """The result or the StampedeError."""
        assert self._outcomes, "it ought to be done by now"
        (outcome,) = self._outcomes
        return outcome if isinstance(outcome, st.StampedeError) else self._convert(outcome)

    def at_once(self) -> Any:
        """The outcome of a call that has no time to wait, or none left."""
        if not self.is_done():
            self._give_up()
        return self.outcome()


class WaitingPut:
    """A run as far as it is settled; `retry_at` is when time makes room for the rest."""

    def __init__(self, run: Run, call: Call) -> None:
        self.run, self.call = run, call
        self.offer = run.offer
        self.retry_at: int | None = None
        self._settled = 0
        self._first_seq: int | None = None
        self._stamped: int | None = None
        self._refused: dict[int, str] = {}

    @property
    def payloads(self) -> Sequence[bytes]:
        return self.run.payloads[self._settled :]

    def settle(self, outcome: PutOutcome, now: int) -> bool:
        """True if none of its items has to wait."""
        if outcome.run is not None and self._first_seq is None:
            self._first_seq, self._stamped = outcome.run.first_seq, outcome.stamped_time
        self._refused |= {self._settled + one.index: one.error.reason for one in outcome.rejections}
        if outcome.waiting is not None:
            self.offer, self.retry_at = self.offer.rest(outcome.waiting, now), outcome.retry_at
            self._settled += outcome.waiting
        return outcome.waiting is None

    def fail(self, error: st.StampedeError, now: int) -> None:
        """The rest is not taken; if nothing was, the run is refused as a whole."""
        if not self.is_partly_accepted:
            self.call.finish(error)
        else:
            self._refused |= dict.fromkeys(range(self._settled, len(self.run.payloads)), error.reason)
            self.call.finish(self.ack(now))

    @property
    def is_partly_accepted(self) -> bool:
        return self._first_seq is not None

    def ack(self, now: int) -> Ack:
        return Ack(self._first_seq, self._stamped, self._refused, now)
