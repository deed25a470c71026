"""Prints metrics in the text format of Prometheus, a family at a time."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from stampede_rt.escaping import escaped
from stampede_rt_runtime.metrics.families import AnyFamily, HistogramFamily, MetricKind

CONTENT_TYPE = CONTENT_TYPE_PLAIN_0_0_4


def printed(family: AnyFamily) -> bytes:
    """The lines of one family: its help, its type and its samples."""
    return printed_metric(_metric(family))


def printed_metric(metric: Metric) -> bytes:
    """The lines of a metric of the library."""
    return generate_latest(_SingleMetric(metric))


class _SingleMetric(Collector):
    """A collector of one metric."""

    def __init__(self, metric: Metric) -> None:
        self._metric = metric

    def collect(self) -> Iterator[Metric]:
        yield self._metric


def _metric(family: AnyFamily) -> Metric:
    name, help = family.metric.name, family.metric.help
    if isinstance(family, HistogramFamily):
        made = HistogramMetricFamily(name, help)
        made.add_metric([], list(family.buckets), family.sum_seconds)
        return made
    kind = CounterMetricFamily if family.metric.kind is MetricKind.COUNTER else GaugeMetricFamily
    prometheus_metric = kind(name, help, labels=family.metric.labels)
    for labels, value in family.samples:
        prometheus_metric.add_metric([escaped(one) for one in labels], value)
    return prometheus_metric
