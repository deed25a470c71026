"""One run that a producer puts into a queue. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.core.queue.limits import ITEM_OVERHEAD_BYTES
from stampede_rt_channel_host.core.queue.values import SealRun
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunProgress


class Enqueue:
    """A run that a producer puts into a queue, and its progress.

    The run may wait for room for `wait_nanos`, or without limit if this is None. `is_stamped`: the run came without
    times, so the host gives its messages their time. A run with a `message_id` has one message. `is_duplicate`: the
    queue knew the message id. At the end the run has either an `outcome` or, if the queue refused it as a whole, an
    `error`. `caller_name`: see `RetryWindow.record`.
    """

    __slots__ = (
        "caller_name", "due", "error", "first_number", "is_duplicate", "is_stamped", "lengths", "message_id", "order",
        "outcome", "producer_id", "progress", "seal", "wait_nanos",
    )  # fmt: skip

    def __init__(
        self,
        lengths: Sequence[int],
        seal: SealRun,
        *,
        is_stamped: bool = True,
        producer_id: int = 0,
        first_number: int = 0,
        wait_nanos: int | None = None,
        message_id: str = "",
        caller_name: str = "",
    ) -> None:
        self.caller_name = caller_name
        self.lengths = lengths
        self.seal = seal
        self.is_stamped = is_stamped
        self.producer_id = producer_id
        self.first_number = first_number
        self.wait_nanos = wait_nanos
        self.message_id = message_id
        self.is_duplicate = False
        self.progress = RunProgress(len(lengths))
        self.outcome: RunOutcome | None = None
        self.error: StampedeError | None = None
        self.due: int | None = None
        self.order = 0

    @property
    def is_done(self) -> bool:
        """Whether the run is done: none of its messages waits."""
        return self.outcome is not None or self.error is not None

    @property
    def charged_bytes(self) -> int:
        """The bytes that its messages count against the limits of memory."""
        return sum(self.lengths) + len(self.lengths) * ITEM_OVERHEAD_BYTES
