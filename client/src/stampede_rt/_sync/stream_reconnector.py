# Generated from ../_async by tools/generate.py; do not edit.
"""Opens streams again after a break: tries at growing intervals, for as long as the program allows."""

from __future__ import annotations

import logging
import random
from collections.abc import Callable

from stampede_rt._sync.session import CALL_TIMEOUT_S, Session
from stampede_rt.errors import DeadlineExceeded, IncarnationLost, InvalidArgument, StampedeError
from stampede_rt.pacing.retry import Backoff
from stampede_rt.transports.concurrency_sync import monotonic_s, sleep
from stampede_rt.values.timeline import DurationLike, format_duration, parse_duration

TRY_TIMEOUT_S = 5.0  # for one try, after the first opening
SILENT_S = 10.0  # the client logs an outage that lasts longer
_log = logging.getLogger("stampede_rt")


class StreamReconnector:
    """Opens a stream, and opens it again after each break, for at most `reconnect` (None: without a limit).

    The first opening fails after CALL_TIMEOUT_S, so that the caller soon learns of a wrong name. With `held` the stream
    counts as already open, so that the first opening, too, may take as long as `reconnect`. `what` names the stream in
    logs.
    """

    def __init__(self, session: Session, what: str, reconnect: DurationLike | None, *, held: bool = False) -> None:
        self._session = session
        self._what = what
        self._bound_s = parse_reconnect(reconnect)
        self._held = held
        self._since_s: float | None = None  # when the client noticed the present break; None while the stream is open
        self._is_logged = False  # whether the client has logged the present break
        self.ended = False  # whether someone has called `stop`
        self.reconnects = 0

    @property
    def connected(self) -> bool:
        """Whether the stream is open, as last known."""
        return self._held and self._since_s is None and not self.ended and not self._session.closed

    def stop(self) -> None:
        """End all tries."""
        self.ended = True

    def broke(self) -> None:
        """Note that the stream has broken."""
        if self._since_s is None:
            self._since_s = monotonic_s()

    def open(self, open_once: Callable[[float], None]) -> None:
        """Call `open_once` with the seconds that it may take, until it succeeds or someone calls `stop`.

        Raises an error that no further try can cure. Raises the last error when the break is longer than `reconnect`.
        """
        if not self._held:
            open_once(CALL_TIMEOUT_S)
            self._held = True
            return
        backoff = Backoff(float("inf"))
        while not self.ended and not self._try(open_once, backoff):
            pass

    def _try(self, open_once: Callable[[float], None], backoff: Backoff) -> bool:
        """Try once. Returns True if the stream is open, or if someone has called `stop`.

        Otherwise waits before the next try, and returns False. Raises the error if there must be no next try.
        """
        try:
            open_once(min(self._left_s(), TRY_TIMEOUT_S))
        except StampedeError as error:
            self.broke()
            if self.ended:
                return True
            over = self._left_s() <= 0
            if over:
                self._since_s = None  # if the program uses the stream again, a new time of `reconnect` begins
            if over or not may_heal(error) or self._session.closing or self._session.closed:
                raise
            self._log_long_break(error)
        else:
            self._is_open()
            return True
        sleep(min(backoff.next_delay_s(monotonic_s(), random.random()) or 0.0, self._left_s()))
        return False

    def _left_s(self) -> float:
        began_s = monotonic_s() if self._since_s is None else self._since_s
        return max(began_s + self._bound_s - monotonic_s(), 0.0)

    def _log_long_break(self, error: StampedeError) -> None:
        if not self._is_logged and self._since_s is not None and monotonic_s() - self._since_s > SILENT_S:
            self._is_logged = True
            bound = "" if self._bound_s == float("inf") else f" for {format_duration(round(self._bound_s * 1e9))}"
            _log.warning(
                "%s has been broken for %g s; the client tries again%s: %s", self._what, SILENT_S, bound, error
            )

    def _is_open(self) -> None:
        if self._since_s is None:
            return
        self.reconnects += 1
        if self._is_logged:
            _log.warning("%s is back after %.0f s", self._what, monotonic_s() - self._since_s)
        self._since_s, self._is_logged = None, False


def may_heal(error: StampedeError) -> bool:
    """Whether another try may succeed after `error`."""
    return error.retryable or isinstance(error, DeadlineExceeded)


def loss_after(channel: str, next_seq: int) -> IncarnationLost:
    """Return the error for the loss of the incarnation that a subscription reads.

    `next_seq`: the seq of the next item of the subscription.
    """
    lost = IncarnationLost(
        f"channel {channel!r} has begun anew: its host was lost with its items; items after seq {next_seq - 1} may be "
        "missing; subscribe again to read the new incarnation"
    )
    lost.concerning("channel", channel)
    return lost


def parse_reconnect(reconnect: DurationLike | None) -> float:
    """Return `reconnect` in seconds; infinity for None. Raises InvalidArgument for a negative duration."""
    if reconnect is None:
        return float("inf")
    nanos = parse_duration(reconnect, "reconnect")
    if nanos < 0:
        raise InvalidArgument(f'reconnect is {reconnect!r}; give "0s" or more, or None to try without a limit')
    return nanos / 1e9
