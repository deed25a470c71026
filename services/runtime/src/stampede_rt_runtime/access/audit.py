"""The audit log: who was denied what, and who changed who may do what. One line for each event, on the service's log.

A caller that is denied again and again gets a line a second at most; the next line tells how many were left out.
"""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable

from stampede_rt_runtime.access.caller import Caller

logger = logging.getLogger("stampede_rt.audit")

LINE_SECONDS_MIN = 1.0
SUBJECTS_MAX = 1024


class AuditLog:
    """The lines of one port. `denials` counts all, also those that were left out."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._last: OrderedDict[str, tuple[float, int]] = OrderedDict()  # when a line was written, and left out since
        self.denials = 0
        self._denied_s: float | None = None

    def denied_ago_nanos(self) -> int | None:
        """How long ago the last denial was; None: there was none."""
        return None if self._denied_s is None else round((self._clock_s() - self._denied_s) * 1e9)

    def denied(self, caller: Caller | None, address: str, verb: str, name: str) -> None:
        """`caller` None: it brought no proof that is accepted. `verb`: of the rules, or the method's name."""
        self.denials += 1
        self._denied_s = self._clock_s()
        left_out = self._turn(address.rpartition(":")[0] if caller is None else caller.name)
        if left_out is not None:
            logger.warning("denied", extra=_facts(caller, address, verb, name, "denied") | {"left_out": left_out})

    def changed(self, caller: Caller | None, address: str, verb: str, name: str) -> None:
        """Rules, tokens, members, owners: what few may change is always told."""
        logger.info("changed", extra=_facts(caller, address, verb, name, "done"))

    def _turn(self, subject: str) -> int | None:
        """How many lines were left out since the last one; None: it is too early for the next."""
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
