"""Asks the directory for records, so that no answer counts that is older than the host's own knowledge."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeVar

from stampede_rt.errors import error_for

LOOKUPS_MAX = 3
"""The most lookups of one record. The host repeats a lookup during which the channel or queue changed here."""
Record = TypeVar("Record")


async def confirmed_record(
    look_up: Callable[[bytes], Awaitable[Record]], subject_id: bytes, version: Callable[[], object]
) -> Record:
    """The directory's record of the channel or queue with this id.

    Repeats the lookup if `version()` changes before the answer comes. Such an answer may be out of date: the channel
    may have moved to this host meanwhile, or the lease ended before the host registered again, and the channel got a
    new owner. `version()` changes with each registration, and when this host gets, drops or replaces the channel, or
    learns of another epoch. Raises the error that the directory answers. Raises StaleBinding (NOT_HERE) if the version
    changed during each of LOOKUPS_MAX lookups.
    """
    for _ in range(LOOKUPS_MAX):
        before = version()
        record = await look_up(subject_id)
        if before == version():
            return record
    text = f"{subject_id.hex()} changed at this host while the host asked the directory for it; resolve it again"
    raise error_for("NOT_HERE", text)
