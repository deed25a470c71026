"""Spans of the RPCs that a service serves."""

from __future__ import annotations

from typing import Any

import grpc
import pytest
from opentelemetry import trace
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from stampede_rt.cluster.tracing import span, trace_metadata
from stampede_rt.v1 import directory_service_pb2, directory_service_pb2_grpc
from stampede_rt_runtime.server import serving
from stampede_rt_runtime.tracing import is_traced, tracing_interceptors

Servicer = directory_service_pb2_grpc.DirectoryServiceServicer


class Directory(Servicer):
    async def ListHosts(self, request: Any, context: Any) -> Any:  # noqa: N802
        return directory_service_pb2.ListHostsResponse()

    async def ListChannels(self, request: Any, context: Any) -> Any:  # noqa: N802
        await context.abort(grpc.StatusCode.INTERNAL, "no")


def register(server: grpc.aio.Server) -> None:
    directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server(Directory(), server)


@pytest.fixture
def spans(monkeypatch: pytest.MonkeyPatch) -> InMemorySpanExporter:
    exporter = InMemorySpanExporter()
    provider = TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    monkeypatch.setattr(trace, "_TRACER_PROVIDER", provider)
    return exporter


async def call(address: str, method: str, request: Any) -> None:
    async with grpc.aio.insecure_channel(address) as channel:
        stub: Any = directory_service_pb2_grpc.DirectoryServiceStub(channel)
        await getattr(stub, method)(request, metadata=trace_metadata(), timeout=10)


async def test_a_served_call_is_a_child_of_its_callers_span(spans: InMemorySpanExporter) -> None:
    async with serving(register) as server:
        with span("list", hosts="all"):
            await call(server.address, "ListHosts", directory_service_pb2.ListHostsRequest())
    served, made = spans.get_finished_spans()
    assert (served.name, made.name) == ("stampede_rt.v1.DirectoryService/ListHosts", "stampede list")
    assert served.kind is trace.SpanKind.SERVER
    assert served.parent is not None
    assert served.parent.span_id == made.context.span_id
    assert dict(served.attributes or {})["rpc.method"] == "ListHosts"


async def test_a_call_without_a_trace_begins_one(spans: InMemorySpanExporter) -> None:
    async with serving(register) as server:
        await call(server.address, "ListHosts", directory_service_pb2.ListHostsRequest())
    (served,) = spans.get_finished_spans()
    assert served.parent is None


async def test_a_refused_call_marks_its_span(spans: InMemorySpanExporter) -> None:
    async with serving(register) as server:
        with pytest.raises(grpc.aio.AioRpcError):
            await call(server.address, "ListChannels", directory_service_pb2.ListChannelsRequest())
    assert spans.get_finished_spans()[0].status.status_code is trace.StatusCode.ERROR


@pytest.mark.parametrize("header", ["", "x", "00-0-0-01", "00-" + "f" * 400])
async def test_a_callers_malformed_trace_changes_nothing(spans: InMemorySpanExporter, header: str) -> None:
    async with serving(register) as server, grpc.aio.insecure_channel(server.address) as channel:
        stub: Any = directory_service_pb2_grpc.DirectoryServiceStub(channel)
        metadata = (("traceparent", header),)
        await stub.ListHosts(directory_service_pb2.ListHostsRequest(), metadata=metadata, timeout=10)
    assert spans.get_finished_spans()[0].parent is None


def test_a_server_without_an_sdk_has_no_interceptor_for_spans() -> None:
    assert tracing_interceptors() == []


def test_streams_that_calls_share_and_calls_of_services_have_no_spans() -> None:
    assert is_traced("/stampede_rt.v1.DirectoryService/OpenChannel")
    assert is_traced("/stampede_rt.v1.ChannelService/Subscribe")
    for method in (
        "ChannelService/Put",
        "RaftService/Exchange",
        "DirectoryService/RenewHostLease",
        "DirectoryService/Ping",
    ):
        assert not is_traced(f"/stampede_rt.v1.{method}")
    assert not is_traced("/grpc.health.v1.Health/Check")
