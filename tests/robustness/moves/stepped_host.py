"""A channel host that sends a signal at a planned step of a move: `python -m ... --plan FILE HOST-ARGUMENTS`.

The production code runs unchanged: this program wraps the methods that are the steps of a move, and then runs `stampede
host`. At each step it looks into the plan, a file with "STEP|PID|SIGNAL". If the file names the step, the program
removes the file and sends the signal, perhaps to itself.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from stampede_rt_channel_host.app import main
from stampede_rt_channel_host.copies.feed_stream import FeedStream
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.moves.move_feed import MoveFeed
from stampede_rt_channel_host.copies.moves.outgoing_moves import OutgoingMove, OutgoingMoves
from stampede_rt_channel_host.copies.queues.queue_arrivals import QueueArrivals
from stampede_rt_channel_host.copies.queues.queue_handover import QueueHandovers
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue


class Step(NamedTuple):
    """A step of a move. The host reaches it before the call of a method, or after the call if `is_after`."""

    owner: type
    method: str
    is_after: bool = False


DESTINATION_STEPS = {
    "destination: has opened the feed": Step(MoveFeed, "_begin", is_after=True),
    "destination: asks the source to hold": Step(MoveFeed, "hold"),
    "destination: has everything": Step(MoveDirectory, "commit"),
    "destination: is the owner": Step(MoveDirectory, "commit", is_after=True),
    "destination: tells the source": Step(MoveFeed, "committed", is_after=True),
    "destination: has removed the fallback": Step(MoveDirectory, "remove_fallback", is_after=True),
    "destination: releases the source": Step(MoveFeed, "released"),
}
SOURCE_STEPS = {
    "source: begins": Step(OutgoingMoves, "begin"),
    "source: holds": Step(OutgoingMove, "hold", is_after=True),
    "source: has handed over": Step(FeedStream, "_hand_off", is_after=True),
    "source: learns of the commit": Step(OutgoingMove, "committed"),
    "source: is released": Step(OutgoingMove, "released"),
}
QUEUE_DESTINATION_STEPS = {
    "destination: asks for the queue": Step(QueueArrivals, "_move"),
    "destination: has the whole queue": Step(QueueArrivals, "_take_over"),
    "destination: owns the queue": Step(MoveDirectory, "commit_queue", is_after=True),
    "destination: serves the queue": Step(QueueArrivals, "_move", is_after=True),
}
QUEUE_SOURCE_STEPS = {
    "source: holds the queue": Step(HostedQueue, "hold", is_after=True),
    "source: all replicas have the queue": Step(HostedQueue, "wait_until_replicated", is_after=True),
    "source: learns the new owner of the queue": Step(QueueHandovers, "_end"),
}


def reach(plan: Path, name: str) -> None:
    """Send the signal that the plan names for this step, if any."""
    try:
        step, pid, number = plan.read_text().split("|")
    except FileNotFoundError:
        return
    if step == name:
        plan.unlink()
        os.kill(int(pid), int(number))


def wrapped(step: Step, reached: Callable[[], None]) -> Callable[..., Any]:
    """The method of the step, wrapped so that it also calls `reached`."""
    inner = getattr(step.owner, step.method)
    if not inspect.iscoroutinefunction(inner):

        def plain(*arguments: Any, **options: Any) -> Any:
            if not step.is_after:
                reached()
            result = inner(*arguments, **options)
            if step.is_after:
                reached()
            return result

        return plain

    async def awaited(*arguments: Any, **options: Any) -> Any:
        if not step.is_after:
            reached()
        result = await inner(*arguments, **options)
        if step.is_after:
            reached()
        return result

    return awaited


def run(steps: Mapping[str, Step]) -> int:
    """Run the host, whose methods reach these steps."""
    _, word, plan, *arguments = sys.argv
    assert word == "--plan"
    for name, step in steps.items():
        setattr(step.owner, step.method, wrapped(step, partial(reach, Path(plan), name)))
    sys.argv = [sys.argv[0], *arguments]
    return main()


if __name__ == "__main__":
    sys.exit(run(DESTINATION_STEPS | SOURCE_STEPS | QUEUE_DESTINATION_STEPS | QUEUE_SOURCE_STEPS))
