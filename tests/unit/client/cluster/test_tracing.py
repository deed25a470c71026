"""Spans of the program's calls: without an SDK there are none, and no measurable cost."""

from __future__ import annotations

import subprocess
import sys

import pytest
from opentelemetry import trace
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from stampede_rt.cluster import tracing
from stampede_rt.cluster.call_metadata import CallMetadata


@pytest.fixture
def spans(monkeypatch: pytest.MonkeyPatch) -> InMemorySpanExporter:
    exporter = InMemorySpanExporter()
    provider = TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    monkeypatch.setattr(trace, "_TRACER_PROVIDER", provider)
    return exporter


def test_the_client_loads_nothing_of_opentelemetry_by_itself() -> None:
    program = "import sys, stampede_rt as st; st.connect; assert not [m for m in sys.modules if 'opentelemetry' in m]"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_without_an_sdk_there_is_one_object_for_all_spans_and_no_metadata() -> None:
    assert tracing.span("put", channel="a") is tracing.span("get", channel="b")
    assert tracing.trace_metadata() == ()


def test_a_call_has_a_span_with_its_name_and_its_subject(spans: InMemorySpanExporter) -> None:
    with tracing.span("put", channel="cam/left"):
        pass
    (one,) = spans.get_finished_spans()
    assert (one.name, dict(one.attributes or {})) == ("stampede put", {"stampede.channel": "cam/left"})
    assert one.kind is trace.SpanKind.CLIENT


def test_a_failed_call_marks_its_span(spans: InMemorySpanExporter) -> None:
    with pytest.raises(ValueError), tracing.span("put", channel="a"):
        raise ValueError("no")
    assert spans.get_finished_spans()[0].status.status_code is trace.StatusCode.ERROR


def test_the_metadata_of_an_rpc_names_the_present_span_only(spans: InMemorySpanExporter) -> None:
    metadata = CallMetadata(lambda: "secret")
    with tracing.span("open", channel="a") as made:
        context = made.get_span_context()
        assert dict(metadata())["traceparent"].startswith(f"00-{context.trace_id:032x}-{context.span_id:016x}-")
    assert "traceparent" not in dict(metadata())
