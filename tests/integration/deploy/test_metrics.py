"""Prometheus scrapes a real cluster, also while its parts are killed."""

from __future__ import annotations

import shutil
import subprocess
import urllib.parse
import urllib.request
from collections.abc import Iterator

import pytest

import stampede_rt as st
from stampede_rt_channel_host.metrics import catalog as host_metrics
from stampede_rt_frontend import metrics as frontend_metrics
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.metrics import service_metrics
from stampede_rt_supernode import metrics as supernode_metrics
from tests.support.cluster import running_cluster
from tests.support.prometheus import Prometheus

SECONDS = 60
needs_prometheus = pytest.mark.skipif(shutil.which("prometheus") is None, reason="Debian's prometheus is not installed")
needs_promtool = pytest.mark.skipif(shutil.which("promtool") is None, reason="Debian's prometheus is not installed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with running_cluster(hosts=2, supernodes=3, metrics="localhost:0", multicast="239.255.7.9:7589") as made:
        yield made


@pytest.fixture(scope="module")
def prometheus(cluster: LocalCluster, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prometheus]:
    made = Prometheus(cluster, tmp_path_factory.mktemp("prometheus"))
    try:
        yield made
    finally:
        made.stop()


def page(address: str) -> str:
    with urllib.request.urlopen(f"http://{address}/metrics", timeout=10) as answer:
        return str(answer.read().decode())


@needs_promtool
def test_every_page_passes_the_check_of_prometheus(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        rt.channel("metrics/checked").put(b"x")
        rt.queue("metrics/queue").put(b"x")
    for name, address in cluster.metrics.items():
        done = subprocess.run(["promtool", "check", "metrics"], input=page(address), text=True, capture_output=True)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), name


def test_each_service_exports_all_its_metrics(cluster: LocalCluster) -> None:
    service_families = {
        "host": host_metrics.METRICS,
        "supernode": supernode_metrics.METRICS,
        "front-end": frontend_metrics.METRICS,
    }
    families_of_absent_parts = {
        service_metrics.CERTIFICATE_EXPIRY,
        host_metrics.ARCHIVE_BYTES,
        host_metrics.ARCHIVE_LIMIT,
        *host_metrics.OF_OBJECT_STORES,
    }
    for title, address in cluster.metrics.items():
        lines = page(address).splitlines()
        exported = {line.split()[2] for line in lines if line.startswith("# TYPE ")}
        own = service_families[title.split()[0]]
        expected = {one.name for one in {*own, *service_metrics.METRICS} - families_of_absent_parts}
        assert expected <= exported, expected - exported
        assert {one for one in exported if not one.startswith("process_")} == expected


@needs_prometheus
def test_prometheus_scrapes_every_part_and_its_counts_are_true(cluster: LocalCluster, prometheus: Prometheus) -> None:
    prometheus.until('sum(up{job="stampede"})', lambda values: values == [float(len(cluster.metrics))])
    with st.connect(cluster.address) as rt:
        channels = [rt.channel(f"metrics/true/{number}") for number in range(8)]
        for channel in channels:
            for _ in range(25):
                channel.put(b"12345678")
        one = 'sum(stampede_channel_items_accepted_total{channel=~"metrics/true/.*"})'
        prometheus.until(one, lambda values: values == [200.0])
        accepted_bytes = 'sum(stampede_channel_items_accepted_bytes_total{channel=~"metrics/true/.*"})'
        assert prometheus.ask(accepted_bytes)[0][1] == 1600
    assert prometheus.ask("max(stampede_raft_members_serving)")[0][1] == 3
    assert prometheus.ask("sum(stampede_host_lease_held)")[0][1] == 2
    assert not [alert for alert, _ in prometheus.ask('ALERTS{alertstate="firing",severity="critical"}')]


@needs_prometheus
def test_the_metrics_show_that_a_killed_part_is_down_and_up_again(
    cluster: LocalCluster, prometheus: Prometheus
) -> None:
    everybody = float(len(cluster.metrics))
    prometheus.until('sum(up{job="stampede"})', lambda values: values == [everybody])
    for process in (cluster.hosts[0], cluster.supernodes[0], cluster.frontends[0]):
        process.kill()
        prometheus.until(f'up{{part="{process.name}"}}', lambda values: values == [0.0])
        process.start()
        process.wait_ready(SECONDS)
        prometheus.until('sum(up{job="stampede"})', lambda values: values == [everybody])
    prometheus.until("max(stampede_raft_members_serving)", lambda values: values == [3.0])
    prometheus.until("sum(stampede_ready)", lambda values: values == [everybody])
