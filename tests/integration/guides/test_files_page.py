"""docs/files.md, run from top to bottom: its Python, and its commands."""

from __future__ import annotations

import io
import re
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=2)
PAGE = Path(__file__).resolve().parents[3] / "docs" / "files.md"
BLOCK = re.compile(r"^```(python|console)\n(.*?)^```", re.MULTILINE | re.DOTALL)
PRINTED = re.compile(r"print\(.*\)  # (.*)")
COMMAND = re.compile(r"^\$ (.*?)(?:  # status (\d))?$", re.MULTILINE)


@pytest.fixture
def before(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """The channels that the page's reader has."""
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.chdir(tmp_path)
    with st.connect() as rt:
        for number in range(3):
            rt.channel("imu", max_age="60s").put(b"%d" % number)
            rt.channel("rig/camera", max_age="60s")
            rt.channel("readings/imu", codec="json").put({"x": number})
            rt.channel("narrow", max_items=1).put(b"%d" % number)
        yield


def test_every_example_of_the_page_gives_the_stated_result(before: None) -> None:
    names: dict[str, Any] = {}
    blocks = BLOCK.findall(PAGE.read_text())
    assert len(blocks) >= 5
    try:
        for kind, block in blocks:
            if kind == "console":
                for command, status in COMMAND.findall(block):
                    assert run(command) == int(status or 0), command
                continue
            printed = io.StringIO()
            with redirect_stdout(printed):
                exec(compile(block, str(PAGE), "exec"), names)
            assert printed.getvalue().splitlines() == PRINTED.findall(block)
    finally:
        if "rt" in names:
            names["rt"].close()


def run(command: str) -> int:
    if command.startswith("stampede "):
        return main(shlex.split(command)[1:])
    return subprocess.run(command, shell=True, check=False, timeout=30).returncode
