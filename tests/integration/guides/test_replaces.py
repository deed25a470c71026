"""docs/replaces.md: our programs on a cluster, and the programs for Redis, NATS and Zenoh on their own servers."""

from __future__ import annotations

import io
import re
import shlex
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from stampede_rt.cli.main import main
from stampede_rt_bench.peers.nats_server import nats_server, why_unavailable
from stampede_rt_bench.peers.reachable import is_listening
from stampede_rt_bench.workloads.processes import server
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.ports import free_ports
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
PAGE = Path(__file__).resolve().parents[3] / "docs/replaces.md"
SECTIONS = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE.read_text(), re.MULTILINE | re.DOTALL))
PRINTED = re.compile(r"print\(.*\)  # (.*)")


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def check(program: str, names: dict[str, Any]) -> None:
    """Run a program of the page, and compare its output with the comments beside it."""
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(compile(program, str(PAGE), "exec"), names)
    assert printed.getvalue().splitlines() == PRINTED.findall(program)


def test_our_programs_print_the_stated_output(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    found = re.findall(r"^```(python|console)\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert len(found) == 1 + len(SECTIONS)
    try:
        for language, block in found:
            if language == "python":
                check(block, names)
            else:
                for line in block.splitlines():
                    assert main(shlex.split(line.removeprefix("$ stampede "))) == 0, line
    finally:
        names["rt"].close()


def test_every_system_has_its_program_beside_ours() -> None:
    for name, text in SECTIONS.items():
        assert len(blocks(text, "py") or blocks(text, "sh")) == 1, name
        assert len(blocks(text, "python") or blocks(text, "console")) == 1, name


@contextmanager
def redis_names(folder: Path) -> Iterator[dict[str, Any]]:
    if shutil.which("redis-server") is None:
        pytest.skip("redis-server is not installed")
    (port,) = free_ports(1, "127.0.0.1")
    words = ["--port", str(port), "--bind", "127.0.0.1", "--save", "", "--appendonly", "no", "--dir", str(folder)]
    with server(["redis-server", *words], folder / "log", lambda: is_listening(port)):
        yield {"REDIS_PORT": port}


@contextmanager
def nats_names(folder: Path) -> Iterator[dict[str, Any]]:
    if why := why_unavailable():
        pytest.skip(why)
    with nats_server("-js") as served:
        yield {"NATS_URL": served.address}


@contextmanager
def zenoh_names(folder: Path) -> Iterator[dict[str, Any]]:
    zenoh = pytest.importorskip("zenoh")
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    yield {"ZENOH_CONFIG": config}


@pytest.mark.parametrize(
    ("section", "names"), [("Redis Streams", redis_names), ("NATS JetStream", nats_names), ("Zenoh", zenoh_names)]
)
def test_the_program_of_another_system_prints_the_stated_output(section: str, names: Any, tmp_path: Path) -> None:
    (program,) = blocks(SECTIONS[section], "py")
    with names(tmp_path) as given:
        check(program, given)
