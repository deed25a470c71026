"""The audit log: denied calls, and changes of rights. One line for each event, on the service's log.

The log has at most one line a second about the denials of one caller. The next line says how many denials were left
out.
"""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable

from stampede_rt_runtime.access.caller import Caller

logger = logging.getLogger("stampede_rt.audit")

LINE_SECONDS_MIN = 1.0
SUBJECTS_MAX = 1024  # the most callers whose last lines are remembered


class AuditLog:
    """The audit log of one port. `denials` counts all denials, also denials without a line."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        # by caller: the time of the last line, and the denials left out since
        self._last: OrderedDict[str, tuple[float, int]] = OrderedDict()
        self.denials = 0
        self._denied_s: float | None = None

    def denied_ago_nanos(self) -> int | None:
        """The time since the last denial, in nanoseconds; None: there was none."""
        return None if self._denied_s is None else round((self._clock_s() - self._denied_s) * 1e9)

    def denied(self, caller: Caller | None, address: str, verb: str, name: str) -> None:
        """Log a denial. `caller`: None if no credential is accepted. `verb`: an access verb, or a method's name."""
        self.denials += 1
        self._denied_s = self._clock_s()
        left_out = self._turn(address.rpartition(":")[0] if caller is None else caller.name)
        if left_out is not None:
            facts = {"event": "access_denied", **_facts(caller, address, verb, name, "denied"), "left_out": left_out}
            logger.warning("denied", extra=facts)

    def changed(self, caller: Caller | None, address: str, verb: str, name: str, *, done: bool = True) -> None:
        """Log a change of rules, quotas, credentials or members, or the takeover of a peer. Logs each such change.

        `done` False: the change had no effect.
        """
        result = "done" if done else "unchanged"
        logger.info("changed", extra={"event": "access_changed", **_facts(caller, address, verb, name, result)})

    def _turn(self, subject: str) -> int | None:
        """The number of denials left out since the last line; None: it is too early for the next line."""
        now = self._clock_s()
        written, left_out = self._last.get(subject, (-LINE_SECONDS_MIN, 0))
        if now - written < LINE_SECONDS_MIN:
            self._last[subject] = written, left_out + 1
            return None
        self._last[subject] = now, 0
        self._last.move_to_end(subject)
        if len(self._last) > SUBJECTS_MAX:
            self._last.popitem(last=False)
        return left_out


def _facts(caller: Caller | None, address: str, verb: str, name: str, result: str) -> dict[str, object]:
    return {
        "who": caller.name if caller is not None else "",
        "proof": caller.kind if caller is not None else "none",
        "serial": caller.serial if caller is not None else "",
        "address": address,
        "verb": verb,
        "thing": name,
        "result": result,
    }
