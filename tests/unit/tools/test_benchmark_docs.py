"""How reports of benchmarks come into the docs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.benchmark_docs import BEGIN, END, PAGE, charts_of, filled, report_of


def test_a_report_replaces_only_the_text_between_its_markers() -> None:
    page = f"above\n{BEGIN.format('limits')}old\n{END.format('limits')}\nbelow\n"
    once = filled(page, "limits", "new", ["limits-streams.png"])
    images = "![limits-streams](images/bench-limits-streams.png)\n"
    assert once == f"above\n{BEGIN.format('limits')}new\n\n{images}{END.format('limits')}\nbelow\n"
    assert filled(once, "limits", "new", ["limits-streams.png"]) == once


def test_a_page_without_markers_is_refused() -> None:
    with pytest.raises(ValueError, match="no markers for peers"):
        filled("", "peers", "new", [])


def test_the_page_has_markers_for_every_report() -> None:
    for name in ("paper", "growth", "limits", "peers"):
        assert "a new report" in filled(PAGE.read_text(), name, "a new report", [])


def test_reports_are_found_with_their_charts(tmp_path: Path) -> None:
    assert report_of(tmp_path, "peers") is None
    (tmp_path / "peers.md").write_text("# Title\n\ntext\n")
    (tmp_path / "paper.txt").write_text("a table\n")
    for chart in ("peers-streams.png", "get.png"):
        (tmp_path / chart).touch()
    assert (report_of(tmp_path, "peers") or "").strip() == "text"
    assert report_of(tmp_path, "paper") == "```\na table\n```"
    assert charts_of(tmp_path, "peers") == ["peers-streams.png"]
    assert charts_of(tmp_path, "paper") == ["get.png"]
