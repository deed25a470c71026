"""Prints the figures of the stereo demo as sentences. Pure."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stampede_rt_demos.stereo.programme import Side

NANOS_PER_MS = 1_000_000
CLOSE_PIXELS = 1
LINE_CHARS = 100


@dataclass(frozen=True, kw_only=True, slots=True)
class StereoReport:
    """The results of a run.

    `alone_expected`, `alone_reported`: by camera, the numbers of its frames without a partner, as planned and as
    reported to the consumer. `measured`: nanoseconds since the start, measured and true disparity in pixels, for each
    pair.
    `put_p50_nanos`: by camera, the median time of a put before, and after, the second consumer joined; None: no put.
    """

    seconds: int
    sent: Mapping[Side, int]
    pairs_possible: int
    pairs: int
    wrong: int
    alone_expected: Mapping[Side, Sequence[int]]
    alone_reported: Mapping[Side, Sequence[int]]
    dropped: int
    measured: Sequence[tuple[int, int, int]]
    latecomer_pairs: int
    put_p50_nanos: Mapping[Side, tuple[int | None, int | None]]
    answers: int
    unanswered: int
    stops: int
    round_trip_p50_nanos: int | None

    @property
    def told_of_all(self) -> bool:
        """Whether the consumer got a report of every frame without a partner, once, and of no other frame."""
        return all(sorted(self.alone_reported[side]) == list(self.alone_expected[side]) for side in Side)

    @property
    def close(self) -> int:
        """The number of pairs whose measured disparity is right to a pixel."""
        return sum(abs(disparity - truth) <= CLOSE_PIXELS for _, disparity, truth in self.measured)


def facts(report: StereoReport) -> dict[str, object]:
    """Return the results as data for JSON."""
    names = (
        *("seconds", "pairs_possible", "pairs", "wrong", "dropped", "told_of_all", "close", "latecomer_pairs"),
        *("answers", "unanswered", "stops", "round_trip_p50_nanos"),
    )
    return {
        "demo": "stereo",
        **{name: getattr(report, name) for name in names},
        "cameras": [_camera(side, report) for side in Side],
    }


def _camera(side: Side, report: StereoReport) -> dict[str, object]:
    before, after = report.put_p50_nanos[side]
    return {
        "camera": side.name.lower(),
        "frames": report.sent[side],
        "without_partner": len(report.alone_expected[side]),
        "told_of": len(report.alone_reported[side]),
        "put_p50_before_nanos": before,
        "put_p50_after_nanos": after,
    }


def render(report: StereoReport) -> str:
    """Return the results as text, one sentence a line."""
    left, right = (report.sent[side] for side in Side)
    alone = sum(len(report.alone_reported[side]) for side in Side)
    expected = sum(len(report.alone_expected[side]) for side in Side)
    lines = [
        f"Cameras: {left} left and {right} right frames in {report.seconds} s, up to 3 ms off their time, some lost.",
        f"Pairs: {report.pairs} of {report.pairs_possible} possible ones; {report.wrong} of two different frames.",
        f"Without a partner: {expected} frames, and the consumer got a report of "
        + (f"{alone}, exactly these." if report.told_of_all else f"{alone}, NOT exactly these."),
        f"Disparity: right to {CLOSE_PIXELS} pixel in {report.close} of {len(report.measured)} pairs.",
        f"A second consumer joined in the middle and got {report.latecomer_pairs} pairs; "
        + "; ".join(_puts(side, report) for side in Side)
        + ".",
        f"Mailboxes: the planner asked {report.answers + report.unanswered} times and got {report.answers} answers, "
        f"half of them within {_millis(report.round_trip_p50_nanos)} ms; {report.stops} times it would have stopped.",
    ]
    if report.dropped:
        lines.append(
            f"{report.dropped} items were dropped before they could be matched: this machine was too slow for the demo."
        )
    return "\n".join(textwrap.fill(line, LINE_CHARS, subsequent_indent="  ") for line in lines)


def subtitle(report: StereoReport) -> str:
    """Return the run in one line, for the picture."""
    alone = sum(len(report.alone_reported[side]) for side in Side)
    named = "all named" if report.told_of_all else "NOT all named"
    return (
        f"{report.pairs} of {report.pairs_possible} pairs, {report.wrong} wrong; {alone} frames without a partner, "
        f"{named}; two hosts, consumers in processes of their own"
    )


def _puts(side: Side, report: StereoReport) -> str:
    before, after = report.put_p50_nanos[side]
    return f"a put of the {side.name.lower()} camera took {_millis(before)} ms before and {_millis(after)} ms after"


def _millis(nanos: int | None) -> str:
    return "-" if nanos is None else f"{nanos / NANOS_PER_MS:.1f}"
