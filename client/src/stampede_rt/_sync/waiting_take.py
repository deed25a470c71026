# Generated from ../_async by tools/generate.py; do not edit.
"""One caller that waits for a message of a queue."""

from __future__ import annotations

from stampede_rt._sync.message import Message
from stampede_rt.errors import StampedeError
from stampede_rt.transports.concurrency_sync import Signal


class WaitingTake:
    """One `get` that waits for a message. It ends with a message, with an error, or after its timeout with neither."""

    def __init__(self) -> None:
        self.finished = Signal()  # is set together with `message` or `error`
        self.requested = Signal()  # set when the taker has asked the host for a message for this caller
        self.is_leaving = False  # the caller's time is over; it only takes a message that is already on the way
        self.message: Message | None = None
        self.error: StampedeError | None = None

    def finish(self, message: Message | None = None, *, error: StampedeError | None = None) -> None:
        """End the wait with a message, with an error, or, because the handle is closed, with neither."""
        self.message, self.error = message, error
        self.requested.set()
        self.finished.set()
