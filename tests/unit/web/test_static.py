"""Unit tests of the page's static files: vendored code is unchanged, and nothing comes from elsewhere."""

from __future__ import annotations

import hashlib
import re

from stampede_rt_web.site import STATIC


def test_the_vendored_files_have_the_checksums_of_their_release() -> None:
    rows = re.findall(r"^\| (\S+) \| ([0-9a-f]{64}) \|$", (STATIC / "vendor/README.md").read_text(), re.MULTILINE)
    assert len(rows) == 2
    for name, checksum in rows:
        assert hashlib.sha256((STATIC / "vendor" / name).read_bytes()).hexdigest() == checksum


def test_the_page_loads_nothing_from_elsewhere_and_has_no_inline_script() -> None:
    page = (STATIC / "index.html").read_text()
    assert "//" not in page
    assert re.findall(r"<script(?![^>]*\bsrc=)", page) == []
    assert re.findall(r"\b(on\w+|style)=", page) == []


def test_no_script_of_the_page_turns_text_into_markup() -> None:
    for script in STATIC.glob("*.js"):
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(", script.read_text()), (
            script
        )
