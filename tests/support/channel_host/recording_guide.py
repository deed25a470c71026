"""Runs the examples of docs/recording.md at a cluster whose hosts have archives."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.support.waiting import wait_until

PAGE = Path(__file__).resolve().parents[3] / "docs" / "recording.md"


def check_guide(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that each example prints the output that its comments state."""
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))
    names: dict[str, Any] = {}
    for number, block in enumerate(re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)):
        printed = io.StringIO()
        with redirect_stdout(printed):
            exec(compile(block, PAGE.name, "exec"), names)
        assert printed.getvalue().splitlines() == re.findall(r"print\(.*\)  # (.*)", block)
        if not number:
            wait_until(lambda: names["imu"].stats().held <= 10, "memory holds only the newest items")
