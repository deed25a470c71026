"""Metrics as values: their names, help texts and labels, and the samples of one moment. Pure."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate


class MetricKind(StrEnum):
    """The kind of a metric, as Prometheus knows it."""

    COUNTER = "counter"
    GAUGE = "gauge"
    HISTOGRAM = "histogram"


@dataclass(frozen=True, slots=True)
class Metric:
    """One metric. `labels`: the names of its labels."""

    name: str
    kind: MetricKind
    help: str
    labels: tuple[str, ...] = ()

    def of(self, value: float, *labels: str) -> Family:
        """The metric with one sample. `labels`: the values of its labels, in their order."""
        return Family(self, [(labels, value)])

    def family(self, samples: Iterable[tuple[tuple[str, ...], float]]) -> Family:
        """The metric with many samples, each with the values of its labels."""
        return Family(self, list(samples))


def counter(name: str, help: str, *labels: str) -> Metric:
    """A number that only grows, until the service starts again. The name ends in `_total`."""
    return Metric(name, MetricKind.COUNTER, help, labels)


def gauge(name: str, help: str, *labels: str) -> Metric:
    """A number that goes up and down."""
    return Metric(name, MetricKind.GAUGE, help, labels)


def histogram(name: str, help: str) -> Metric:
    """Counts of durations, by their length in seconds."""
    return Metric(name, MetricKind.HISTOGRAM, help)


@dataclass(frozen=True, slots=True)
class Family:
    """A metric and its samples of one moment."""

    metric: Metric
    samples: list[tuple[tuple[str, ...], float]]


@dataclass(frozen=True, slots=True)
class HistogramFamily:
    """A histogram of one moment. `buckets`: for each upper bound the number of durations up to it."""

    metric: Metric
    buckets: Sequence[tuple[str, float]]
    sum_seconds: float


class Durations:
    """Counts durations by their length. One thread may add while others read."""

    def __init__(self, bounds_seconds: Sequence[float]) -> None:
        """`bounds_seconds`: the upper bounds of the buckets, ascending. One more bucket has no bound."""
        self._bounds = tuple(bounds_seconds)
        self._counts = [0] * (len(self._bounds) + 1)
        self._sum_seconds = 0.0

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self._counts[bisect_left(self._bounds, seconds)] += 1
        self._sum_seconds += seconds

    def family(self, metric: Metric) -> HistogramFamily:
        """The counts so far, as samples of `metric`."""
        bounds = [*(f"{one:g}" for one in self._bounds), "+Inf"]
        return HistogramFamily(metric, list(zip(bounds, accumulate(self._counts), strict=True)), self._sum_seconds)


AnyFamily = Family | HistogramFamily
