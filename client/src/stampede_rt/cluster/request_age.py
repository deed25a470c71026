"""The age of an update: the seconds since the client first sent it. Each repeated request states its age.

The directory remembers its answers by request id for a limited time. It refuses updates that are older than this time
(directory_service.proto). The client measures the age by its own clock, so no two clocks need to agree.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

from stampede_rt.errors import InvalidArgument

METADATA_KEY = "stampede-request-age-ms"
_DIGITS_MAX = 12
# Linux stops CLOCK_MONOTONIC while the machine sleeps. Other systems have one clock, which does not stop.
_BOOTTIME = getattr(time, "CLOCK_BOOTTIME", None)


def age_clock_s() -> float:
    """Return the time of the clock that measures ages, in seconds.

    On Linux the clock also counts the time for which the machine slept, because the directory forgets answers during
    that time, too.
    """
    return time.monotonic() if _BOOTTIME is None else time.clock_gettime(_BOOTTIME)


def age_metadata(age_s: float) -> tuple[tuple[str, str], ...]:
    """Return the metadata that states the age of a repeated request; empty for the first request."""
    age_ms = int(age_s * 1000)
    return ((METADATA_KEY, str(age_ms)),) if age_ms > 0 else ()


def request_age_nanos(metadata: Iterable[Any] | None) -> int:
    """Return the age that a call states; 0 if it states none. Raises InvalidArgument."""
    stated = next((value for key, value in metadata or () if key == METADATA_KEY), "0")
    if not (isinstance(stated, str) and stated.isascii() and stated.isdigit() and len(stated) <= _DIGITS_MAX):
        raise InvalidArgument(f"the metadata {METADATA_KEY} is {stated!r}; it must be whole milliseconds")
    return int(stated) * 1_000_000
