"""A skipped test says why. Only a tool that the machine lacks is a reason to skip."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from tests.polyglot import toolchains


def printing(text: str) -> list[str]:
    return [sys.executable, "-c", f"print({text!r}); raise SystemExit(1)"]


def test_a_missing_tool_is_named() -> None:
    with pytest.raises(toolchains.Unavailable, match="no-such-compiler is not installed"):
        toolchains.tool("no-such-compiler")


@pytest.mark.parametrize(
    "output",
    [
        "go: module example.org/x: Get: dial tcp: lookup proxy: no such host",
        "npm error code EAI_AGAIN",
        "npm error code ECONNREFUSED",
    ],
)
def test_an_unreachable_registry_is_a_reason_to_skip(output: str, tmp_path: Path) -> None:
    with pytest.raises(toolchains.Unavailable, match="cannot reach"):
        toolchains.step(printing(output), tmp_path, dict(os.environ))


@pytest.mark.parametrize(
    "output",
    ["main.go:3:2: undefined: v1.Nothing", "SECURITY ERROR: checksum mismatch", "npm error code ETARGET"],
)
def test_a_broken_client_or_pin_is_a_failure(output: str, tmp_path: Path) -> None:
    with pytest.raises(toolchains.BuildFailed):
        toolchains.step(printing(output), tmp_path, dict(os.environ))


def test_a_fetched_toolchain_is_not_fetched_again_unless_the_pins_change(tmp_path: Path) -> None:
    stamp = tmp_path / "fetched"
    assert toolchains.once(stamp, toolchains.digest("a", "1"))
    stamp.write_text(toolchains.digest("a", "1"))
    assert not toolchains.once(stamp, toolchains.digest("a", "1"))
    assert toolchains.once(stamp, toolchains.digest("a", "2"))
