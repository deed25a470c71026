"""The line that shows the progress of long work."""

from __future__ import annotations

import pytest

from stampede_rt.cli.progress import progress_line, shown_progress


def test_a_bar_shows_the_done_share() -> None:
    assert progress_line(0.5, "7 items", 80) == "[############............]  50%  7 items"
    assert progress_line(7.0, "", 80).startswith("[########################] 100%")


def test_without_a_known_total_the_progress_line_is_the_text_within_the_width() -> None:
    assert progress_line(None, "x" * 100, 40) == "x" * 39


def test_nothing_is_written_if_standard_error_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with shown_progress(lambda: pytest.fail("no progress may be asked for")):
        pass
    assert capsys.readouterr() == ("", "")
