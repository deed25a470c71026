"""The spans of a program that has configured an SDK, with a real cluster, over both transports and in both clients."""

from __future__ import annotations

from collections import Counter

import pytest
from opentelemetry import trace
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)


@pytest.fixture
def spans(monkeypatch: pytest.MonkeyPatch) -> InMemorySpanExporter:
    exporter = InMemorySpanExporter()
    provider = TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    monkeypatch.setattr(trace, "_TRACER_PROVIDER", provider)
    return exporter


def span_counts(spans: InMemorySpanExporter) -> Counter[tuple[str, str]]:
    return Counter((one.name, str(next(iter((one.attributes or {}).values())))) for one in spans.get_finished_spans())


@pytest.mark.parametrize("transport", ["grpc", "best"])
def test_each_logical_call_has_one_span(cluster: LocalCluster, spans: InMemorySpanExporter, transport: str) -> None:
    name = f"traced/{transport}"
    with st.connect(cluster.address, transport=transport) as rt:
        left = rt.channel(name)
        left.put(b"x")
        left.newest()
        group = rt.group(name, [left])
        group.newest()
        queue = rt.queue(name)
        queue.put(b"x")
        message = queue.get(timeout=5)
        assert message is not None
        with left.subscribe(start=st.OLDEST) as items:
            next(items)
    found = span_counts(spans)
    for call in ("open", "put", "enqueue", "take", "subscribe"):
        assert found[f"stampede {call}", name] == (3 if call == "open" else 1), call  # a channel, a group and a queue
    assert found["stampede get", name] == 2  # one get of the channel, and one of the group


async def test_the_asynchronous_client_makes_the_same_spans(cluster: LocalCluster, spans: InMemorySpanExporter) -> None:
    async with aio.connect(cluster.address) as rt:
        left = await rt.channel("traced/async")
        await left.put(b"x")
        assert await left.newest() is not None
    found = span_counts(spans)
    assert [found[f"stampede {call}", "traced/async"] for call in ("open", "put", "get")] == [1, 1, 1]


def test_the_span_of_a_failed_call_has_its_error(cluster: LocalCluster, spans: InMemorySpanExporter) -> None:
    with st.connect(cluster.address) as rt, pytest.raises(st.ChannelNotFound):
        rt.channel("traced/absent", create=False)
    (one,) = spans.get_finished_spans()
    assert one.status.status_code is trace.StatusCode.ERROR
