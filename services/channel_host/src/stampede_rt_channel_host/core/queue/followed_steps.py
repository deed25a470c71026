"""The steps that a queue makes from one moment on, for the host to which the queue moves. Pure."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Protocol

from stampede_rt_channel_host.core.channel.pieces import Pieces

if TYPE_CHECKING:
    from stampede_rt_channel_host.core.queue.journal import QueueStep

FREED_PER_PIECE = 64  # a step may have hundreds of messages


class FollowedStep(Protocol):
    """A step of a journal."""

    def step(self) -> QueueStep:
        """The step with all its facts."""


class FollowedSteps:
    """The steps that nobody has taken yet. `bytes_max`: the most bytes of them. `size_bytes`: about their memory.

    `is_too_long`: they were longer, and are lost.
    """

    def __init__(self, bytes_max: int) -> None:
        self._bytes_max = bytes_max
        self._steps: deque[tuple[FollowedStep, int]] = deque()
        self.size_bytes = 0
        self.is_too_long = False

    def __len__(self) -> int:
        """The number of steps."""
        return len(self._steps)

    def add(self, step: FollowedStep, size_bytes: int) -> None:
        """Add the next step."""
        if not self.is_too_long:
            self._steps.append((step, size_bytes))
            self.size_bytes += size_bytes
            self.is_too_long = self.size_bytes > self._bytes_max

    def take(self, count_max: int, bytes_max: int) -> list[QueueStep]:
        """Take the first steps, of about `bytes_max` bytes, but at least one."""
        found: list[QueueStep] = []
        while self._steps and len(found) < count_max and bytes_max > 0:
            step, size_bytes = self._steps.popleft()
            self.size_bytes -= size_bytes
            found.append(step.step())
            bytes_max -= size_bytes
        return found

    def freeing(self) -> Pieces[None]:
        """Free the memory, in pieces."""
        while self._steps:
            self.take(FREED_PER_PIECE, self._bytes_max)
            yield
