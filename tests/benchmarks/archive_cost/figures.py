"""Times, and rows of Markdown tables."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence


def seconds_of(work: Callable[[], object]) -> float:
    """The time that the work takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def heading(*cells: str) -> None:
    """Print the first rows of a table."""
    print()
    row(*cells)
    row(*("---" for _ in cells))


def row(*cells: str) -> None:
    """Print a row."""
    print(f"| {' | '.join(cells)} |", flush=True)


def spread(values: Sequence[float], form: str, unit: str = "") -> str:
    """The median of some values, with the least and the greatest value."""
    least, middle, most = (format(one, form) for one in (min(values), statistics.median(values), max(values)))
    return f"{middle}{unit} ({least} to {most})"


def ratios(values: Sequence[float], others: Sequence[float]) -> str:
    """The ratio of two figures of the same rounds."""
    return spread([one / other for one, other in zip(values, others, strict=True)], ".2f")


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which this share of the values lies."""
    return sorted(values)[min(len(values) - 1, int(len(values) * share))]
