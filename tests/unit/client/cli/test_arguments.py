"""Arguments of verbs as people write them."""

from __future__ import annotations

import argparse

import pytest

from stampede_rt.cli.arguments import timeout_seconds


@pytest.mark.parametrize(("text", "seconds"), [("1s", 1.0), ("500ms", 0.5), ("2m", 120.0), ("1", 1.0), ("0.25", 0.25)])
def test_a_timeout_is_a_duration_or_a_number_of_seconds(text: str, seconds: float) -> None:
    assert timeout_seconds(text) == seconds


@pytest.mark.parametrize("text", ["", "soon", "1 fortnight", "inf", "nan", "-1"])
def test_an_invalid_timeout_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        timeout_seconds(text)
