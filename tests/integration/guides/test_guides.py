"""The guides under docs/, each run from top to bottom as its reader would, and their pictures."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=2)
DOCS = Path(__file__).resolve().parents[3] / "docs"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
PRINTED = re.compile(r"print\(.*\)  # (.*)")
PICTURE = re.compile(r"!\[[^]]*\]\(([^)]+)\)")
RUN = ["time-model.md", "groups.md", "queues.md"]
PAGES = [*RUN, "stereo.md"]

TAUGHT = {
    "time-model.md": [
        "COLLECTED", "NEVER", "NOT_YET", "LOST", "IncarnationLost",
        "max_age=", "max_items=", "max_bytes=", "consumers=", "max_age_unconsumed=", '"reject"', '"block"',
        "configure(", "advance(", "newest(after=", "NOW + ",
    ],
    "groups.md": [
        "reference=", 'bound="end"', "idle_after=", "HIDDEN", "complete=True", ".newest(", ".get(", ".subscribe(",
        ".late[", ".incomplete", ".match(", "unique=True", "lateness=", "partial=True",
        ".missing", ".unmatched", "cross_section(", 'over="span"',
        ".status()", ".waiting_on", ".add(", ".remove(", ".delete()",
    ],
    "queues.md": [
        ".put(", ".get(", ".ack()", ".nack(", ".extend(", "LeaseExpired", "lease=", "max_deliveries=", "dead_letter=",
        ".pending(", ".term(", ".origin", "message_id=", ".duplicate",
        "copies=", "max_items=", "on_full=", "QueueFull", "prefetch=", "configure(", ".stats()", "codec=", "name=",
        "proof=", "PeerExists", "PeerNotFound", ".send(", ".mailbox", ".peers(", ".delete()",
    ],
}  # fmt: skip


def blocks_of(page: str) -> list[str]:
    return BLOCK.findall((DOCS / page).read_text())


@pytest.mark.parametrize("page", RUN)
def test_every_example_of_a_page_prints_the_stated_output(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, page: str
) -> None:
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    names: dict[str, Any] = {}
    try:
        for block in blocks_of(page):
            printed = io.StringIO()
            with redirect_stdout(printed):
                exec(compile(block, str(DOCS / page), "exec"), names)
            assert printed.getvalue().splitlines() == PRINTED.findall(block)
    finally:
        names["rt"].close()


@pytest.mark.parametrize(("page", "term"), [(page, term) for page, terms in TAUGHT.items() for term in terms])
def test_everything_that_a_page_teaches_has_an_example(page: str, term: str) -> None:
    assert any(term in block for block in blocks_of(page))


@pytest.mark.parametrize("page", PAGES)
def test_every_picture_of_a_page_exists(page: str) -> None:
    pictures = PICTURE.findall((DOCS / page).read_text())
    assert page == "queues.md" or pictures
    for picture in pictures:
        with Image.open(DOCS / picture) as image:
            assert min(image.size) > 200


def test_the_pictures_of_time_are_drawn_from_real_channels(cluster: LocalCluster, tmp_path: Path) -> None:
    from tools.time_pictures import draw_all  # not at the top: every worker of the suite would load matplotlib

    drawn = draw_all(cluster.address, tmp_path)
    for path in drawn:
        assert f"images/{path.name}" in (DOCS / "time-model.md").read_text()
        with Image.open(path) as fresh, Image.open(DOCS / "images" / path.name) as committed:
            assert fresh.size == committed.size
            assert len(fresh.convert("RGB").getcolors(2**24) or ()) > 10
