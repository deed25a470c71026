"""The check for docstrings that begin with a clause without its noun."""

from __future__ import annotations

import pytest

from tools.plain_words import complaints, main


@pytest.mark.parametrize(
    "text", ["What was collected.", "Whose turn it is.", "Of two items the later one.", "Tell whoever asks."]
)
def test_a_docstring_without_its_noun_is_found(text: str) -> None:
    (line,) = complaints("a.py", f'def f():\n    """{text}"""\n')
    assert line.startswith("a.py:2: name the noun instead of")


@pytest.mark.parametrize("text", ["The collected items.", "Who leads?", "Whatsoever.", "Offers an item."])
def test_other_docstrings_pass(text: str) -> None:
    assert list(complaints("a.py", f'"""{text}"""\n')) == []


def test_all_modules_pass() -> None:
    assert main() == 0
