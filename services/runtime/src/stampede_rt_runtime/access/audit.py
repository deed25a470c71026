"""The audit log: denied calls, and changes of rights, as lines on the service's log.

Each change gets a line. Denials of one caller get at most one line a second. The next line about this caller says how
many denials have no line.
"""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from urllib.parse import unquote

from stampede_rt_runtime.access.caller import Caller

logger = logging.getLogger("stampede_rt.audit")

LINE_SECONDS_MIN = 1.0
CALLERS_MAX = 1024  # the log remembers the times of the last lines of this many callers


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
        """Log a denial. `caller`: None if it has no valid credential. `verb`: an access verb, or a method's name."""
        self.denials += 1
        self._denied_s = self._clock_s()
        left_out = self._begin_line(address.rpartition(":")[0] if caller is None else caller.name)
        if left_out is not None:
            facts = {"event": "access_denied", **_facts(caller, address, verb, name, "denied"), "left_out": left_out}
            logger.warning("denied", extra=facts)

    def changed(self, caller: Caller | None, address: str, verb: str, name: str, *, done: bool = True) -> None:
        """Log a change of rules, quotas, credentials or members, or the takeover of a peer. Logs each such change.

        `done` False: the change had no effect.
        """
        result = "done" if done else "unchanged"
        logger.info("changed", extra={"event": "access_changed", **_facts(caller, address, verb, name, result)})

    def _begin_line(self, caller: str) -> int | None:
        """Return how many denials of a caller have no line since its last line. None: it is too early for another line.

        `caller`: the name of the caller, or its address if it has no valid credential.
        """
        now = self._clock_s()
        written, left_out = self._last.get(caller, (-LINE_SECONDS_MIN, 0))
        if now - written < LINE_SECONDS_MIN:
            self._last[caller] = written, left_out + 1
            return None
        self._last[caller] = now, 0
        self._last.move_to_end(caller)
        if len(self._last) > CALLERS_MAX:
            self._last.popitem(last=False)
        return left_out


def _facts(caller: Caller | None, address: str, verb: str, name: str, result: str) -> dict[str, object]:
    return {
        "who": caller.name if caller is not None else "",
        "proof": caller.kind if caller is not None else "none",
        "serial": caller.serial if caller is not None else "",
        "address": unquote(address),  # gRPC writes ipv6:%5B::1%5D:5 for ipv6:[::1]:5
        "verb": verb,
        "thing": name,
        "result": result,
    }
