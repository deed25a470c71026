"""Prints the figures of a run: the table and the sentences below it. Pure."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from stampede_rt_demos.staging.statistics import percentile
from stampede_rt_demos.tv_watcher.statistics import StepFigures, StreamFigures

LINE_CHARS = 100
_HEADINGS = ("stream", "host", "items", "in step", "per s", "bytes", "latency p50", "p99 ms", "lost")
_LEGEND = "latency: from the put to the stream's reader (video, audio: the analysers; the others: the viewer)"


@dataclass(frozen=True, kw_only=True, slots=True)
class RunReport:
    """The results of a run. CPU is in per cent of one core, over the length of the programme.

    `expected`: how many items of each stream begin in one span of `reference`; `lateness_max_nanos`: by producer, how
    late the worst put began; `cluster_cpu_percent` includes the cluster's start.
    """

    figures: Sequence[StreamFigures]
    steps: Sequence[StepFigures]
    reference: str
    expected: Mapping[str, int]
    lateness_max_nanos: Mapping[str, int]
    role_cpu_percent: Mapping[str, float]
    cluster_cpu_percent: float

    @property
    def lost(self) -> int:
        """The number of items that a host accepted and the reader never received, in all streams."""
        return sum(figure.lost for figure in self.figures)

    def in_step(self, step: StepFigures) -> bool:
        """Whether the span was complete, had the expected items, and its features had the times of their sources."""
        return step.complete and step.features_keep_times and dict(step.counts) == dict(self.expected)


def facts(report: RunReport) -> dict[str, object]:
    """Return the results as data for JSON."""
    delays = _delays(report.steps)
    return {
        "demo": "tv-watcher",
        "streams": [{**asdict(figure), "lost": figure.lost} for figure in report.figures],
        "spans": len(report.steps),
        "spans_in_step": sum(report.in_step(step) for step in report.steps),
        "delay_p50_nanos": percentile(delays, 50),
        "delay_p99_nanos": percentile(delays, 99),
        "lateness_max_nanos": dict(report.lateness_max_nanos),
        "role_cpu_percent": dict(report.role_cpu_percent),
        "cluster_cpu_percent": report.cluster_cpu_percent,
    }


def render(report: RunReport) -> str:
    """Return the table and the sentences below it."""
    sentences = (textwrap.fill(sentence, LINE_CHARS, subsequent_indent="  ") for sentence in _sentences(report))
    return "\n".join([table(report.figures), _LEGEND, "", *sentences])


def subtitle(report: RunReport) -> str:
    """Return the run in one line, for the picture: the processes, and the delay of a span at the viewer."""
    hosts = len({figure.host for figure in report.figures})
    return (
        f"{len(report.role_cpu_percent)} processes that meet only in {len(report.figures)} channels on {hosts} hosts; "
        f"a span was whole in the viewer's hands {_millis(percentile(_delays(report.steps), 50))} ms after its end"
    )


def table(figures: Sequence[StreamFigures]) -> str:
    """One line per stream, columns aligned; the first two to the left, numbers to the right."""
    rows = [_HEADINGS, *(_row(figure) for figure in figures)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADINGS))]
    heading, *lines = (_aligned(row, widths) for row in rows)
    return "\n".join([heading, "-" * len(heading), *lines])


def bytes_text(count: int) -> str:
    """Return a size as text, in powers of ten: "25.5 MB"."""
    size, unit = float(count), "B"
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            break
        size /= 1000
    return f"{count} B" if unit == "B" else f"{size:.1f} {unit}"


def _row(figure: StreamFigures) -> tuple[str, ...]:
    return (
        figure.name,
        figure.host,
        str(figure.accepted),
        str(figure.in_step),
        f"{figure.accepted / figure.seconds:.1f}",
        bytes_text(figure.payload_bytes),
        _millis(figure.latency_p50_nanos),
        _millis(figure.latency_p99_nanos),
        str(figure.lost),
    )


def _aligned(row: Sequence[str], widths: Sequence[int]) -> str:
    cells = [
        cell.ljust(width) if column < 2 else cell.rjust(width)
        for column, (cell, width) in enumerate(zip(row, widths, strict=True))
    ]
    return "  ".join(cells).rstrip()


def _sentences(report: RunReport) -> list[str]:
    return [_step_sentence(report), _delay_sentence(report.steps), _loss_sentence(report), *_cost_sentences(report)]


def _step_sentence(report: RunReport) -> str:
    good = sum(report.in_step(step) for step in report.steps)
    held = ", ".join(f"{count} {name}" for name, count in report.expected.items() if name != report.reference)
    all_of = "every one" if good == len(report.steps) else f"{good}"
    sentence = (
        f"In step: {all_of} of {len(report.steps)} caption spans held {held} items, each feature at its source's time."
    )
    wrong = [step for step in report.steps if not report.in_step(step)]
    if not wrong:
        return sentence
    counts = ", ".join(f"{count} {name}" for name, count in wrong[0].counts.items())
    state = "complete" if wrong[0].complete else "not complete in time"
    return f'{sentence} The first that did not: "{wrong[0].text}" ({state}: {counts}).'


def _delay_sentence(steps: Sequence[StepFigures]) -> str:
    delays = _delays(steps)
    return (
        f"A span was in the viewer's hands {_millis(percentile(delays, 50))} ms (p50), "
        f"{_millis(percentile(delays, 99))} ms (p99) after it was over."
    )


def _delays(steps: Sequence[StepFigures]) -> list[int]:
    """Return, for each span, the nanoseconds from its end until the viewer had all of it."""
    return [step.received_unix_nano - step.end for step in steps]


def _loss_sentence(report: RunReport) -> str:
    if not report.lost:
        return "Nothing was lost: each stream's reader received every item that its host had accepted."
    lossy = ", ".join(f"{figure.lost} of {figure.name}" for figure in report.figures if figure.lost)
    return f"Lost between host and reader: {lossy}. This machine may be too busy for real time."


def _cost_sentences(report: RunReport) -> list[str]:
    worst = max(report.lateness_max_nanos.items(), key=lambda item: item[1], default=None)
    schedule = [f"Schedule: the latest put began {_millis(worst[1])} ms after its time ({worst[0]})."] if worst else []
    roles = ", ".join(f"{name} {percent:.0f}" for name, percent in report.role_cpu_percent.items())
    cost = f"CPU, % of one core: {roles}; cluster {report.cluster_cpu_percent:.0f} (its start included)."
    return [*schedule, cost]


def _millis(nanos: int | None) -> str:
    return "-" if nanos is None else f"{nanos / 1e6:.1f}"
