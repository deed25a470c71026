"""Prints the figures of the rover demo as sentences. Pure."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

NANOS_PER_MS, NANOS_PER_SECOND = 10**6, 10**9
LINE_CHARS = 100


@dataclass(frozen=True, kw_only=True, slots=True)
class RoverReport:
    """The results of a run.

    `puts`: for each frame its time since the start and how long its put took, in nanoseconds. `by_reference`: the reads
    in the rover's process that returned the very object that was put. `measured`: for each pair its time since the
    start and the disparity in pixels. `commands`: sent by the planner, received by the rover, and not sent because the
    mailbox was at the lost host. `events`: nanoseconds since the start, and a text about the event.
    """

    seconds: int
    frames: int
    puts: Sequence[tuple[int, int]]
    by_reference: int
    pairs_possible: int
    pairs: int
    wrong: int
    dropped: int
    measured: Sequence[tuple[int, int]]
    planner_pairs: int
    commands: tuple[int, int, int]
    events: Sequence[tuple[int, str]]

    @property
    def lost(self) -> int:
        """The number of pairs that did not come, and of items that readers lost."""
        return self.pairs_possible - self.pairs + self.dropped

    @property
    def longest_put_nanos(self) -> int:
        """The time that the slowest put took."""
        return max((nanos for _, nanos in self.puts), default=0)


def facts(report: RoverReport) -> dict[str, object]:
    """Return the results as data for JSON."""
    sent, received, unsent = report.commands
    names = ("seconds", "frames", "by_reference", "pairs_possible", "pairs", "wrong", "lost", "planner_pairs")
    return {
        "demo": "rover",
        **{name: getattr(report, name) for name in names},
        "puts": len(report.puts),
        "longest_put_nanos": report.longest_put_nanos,
        "commands": {"sent": sent, "received": received, "unsent": unsent},
        "events": [{"after_nanos": at, "event": what} for at, what in report.events],
    }


def render(report: RoverReport) -> str:
    """Return the results as text, one sentence a line."""
    sent, received, unsent = report.commands
    lines = [
        f"Rover: {len(report.puts)} of {report.frames} frames put; while the channels were in its own process, "
        f"{report.by_reference} reads returned the very object that was put.",
        *(f"After {at / NANOS_PER_SECOND:.1f} s: {what}." for at, what in report.events),
        f"Pairs: {report.pairs} of {report.pairs_possible} reached the depth consumer, {report.wrong} of two different "
        f"frames; lost: {report.lost}.",
        f"Planner: joined while the rover drove, and got {report.planner_pairs} pairs; the rover noticed nothing.",
        f"Mailbox: {sent} commands sent, {received} received"
        + (f", {unsent} not sent while the mailbox was at the lost host." if unsent else "."),
        f"The longest put took {report.longest_put_nanos / NANOS_PER_SECOND:.1f} s: it waited for the lease of the "
        "killed host to end.",
    ]
    return "\n".join(textwrap.fill(line, LINE_CHARS, subsequent_indent="  ") for line in lines)
