"""docs/time-model.md, run from top to bottom as its reader would, and its pictures."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tools.time_pictures import draw_all

cluster = cluster_fixture(hosts=1, supernodes=1, scope="module")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "time-model.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
PRINTED = re.compile(r"print\(.*\)  # (.*)")


def test_every_example_of_the_page_prints_what_stands_beside_it(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    names: dict[str, Any] = {}
    try:
        for block in BLOCKS:
            printed = io.StringIO()
            with redirect_stdout(printed):
                exec(compile(block, str(PAGE), "exec"), names)
            assert printed.getvalue().splitlines() == PRINTED.findall(block)
    finally:
        names["rt"].close()


@pytest.mark.parametrize("promised", ["COLLECTED", "NEVER", "NOT_YET", "IncarnationLost"])
def test_every_reason_has_an_example(promised: str) -> None:
    assert any(promised in block for block in BLOCKS)


@pytest.mark.parametrize(
    "policy",
    [
        "max_age=",
        "max_items=",
        "max_bytes=",
        "consumers=",
        "max_age_unconsumed=",
        '"reject"',
        '"block"',
        "configure(",
        "advance(",
    ],
)
def test_every_policy_has_an_example(policy: str) -> None:
    assert any(policy in block for block in BLOCKS)


def test_the_pictures_are_drawn_from_real_channels(cluster: LocalCluster, tmp_path: Path) -> None:
    drawn = draw_all(cluster.address, tmp_path)
    for path in drawn:
        assert f"images/{path.name}" in PAGE.read_text()
        with Image.open(path) as fresh, Image.open(PAGE.parent / "images" / path.name) as committed:
            assert fresh.size == committed.size
            assert len(fresh.convert("RGB").getcolors(2**24) or ()) > 10
