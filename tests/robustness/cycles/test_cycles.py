"""After many openings and closings no process holds more memory, files, threads, tasks or objects than before."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.robustness.cycles.counting import HeldResources
from tests.robustness.cycles.cycling import KINDS
from tests.robustness.cycles.running import counted_cluster, run

# Calls that grpc.aio has cancelled stay until the next garbage collection, so a short run cannot show a leak of them.
LONG_ONLY = ("subscribe, await, gRPC",)
WARM_UP, CYCLES = 40, 100  # a leak of one object for each cycle is found
OTHERS = {
    "make channel and queue": (100, 100),  # a heap of deadlines has up to 64 deleted channels
    "add proxy": (50, 200),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("counts")


@pytest.fixture(scope="module")
def cluster(folder: Path) -> Iterator[LocalCluster]:
    with counted_cluster(folder) as made:
        yield made


@pytest.mark.without_rules("a connection with rules keeps its token, and each count would differ")
@pytest.mark.timeout(300)
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in LONG_ONLY])
def test_no_process_grows_over_many_cycles(cluster: LocalCluster, folder: Path, kind: str) -> None:
    report = run(cluster, folder, kind, *OTHERS.get(kind, (WARM_UP, CYCLES)))
    assert report.complaints == []


def test_a_planted_leak_of_each_kind_is_noticed() -> None:
    held = HeldResources(memory_bytes=10**8, files=10, threads=5, tasks=4, objects={"a.Kept": 7})
    more = HeldResources(
        memory_bytes=2 * 10**8, files=110, threads=105, tasks=104, objects={"a.Kept": 107, "a.New": 100}
    )
    assert held.grown_since(held, 100) == []
    assert [one.split()[0] for one in more.grown_since(held, 100)] == [
        "files", "threads", "tasks", "memory_bytes", "a.Kept", "a.New",
    ]  # fmt: skip
