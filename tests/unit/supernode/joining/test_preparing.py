"""`init` and `join` print the command that starts the supernode on a line of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt_supernode.joining import preparing
from tests.support.command_line.documented_fields import require_fields

AT = ("--listen", "127.0.0.1:7591", "--id", "s9")


@contextmanager
def reached(*_: Any) -> Iterator[Any]:
    listed = SimpleNamespace(
        supernodes=[SimpleNamespace(supernode_id="s1", endpoint=SimpleNamespace(target="127.0.0.1:7590"))]
    )
    yield SimpleNamespace(members=lambda: listed)


@pytest.mark.parametrize("verb", [["init"], ["join", "--member", "127.0.0.1:7590", "--token", "c.1.t"]])
def test_the_command_that_starts_the_supernode_is_printed_on_a_line_of_its_own(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(preparing, "reached", reached)
    monkeypatch.setattr(preparing, "log_cluster_of", lambda token: "log")
    folder = tmp_path / "a\x1b[2Jb"
    assert preparing.prepare([*verb, *AT, "--data-dir", str(folder)]) == 0
    first, empty, start = capsys.readouterr().out.splitlines()
    assert first.endswith("Start this supernode:")
    assert empty == ""
    assert start == f"  stampede supernode --listen 127.0.0.1:7591 --data-dir {tmp_path}/a\\x1b[2Jb"


@pytest.mark.parametrize("verb", [["init"], ["join", "--member", "127.0.0.1:7590", "--token", "c.1.t"]])
def test_the_json_output_has_the_documented_fields(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(preparing, "reached", reached)
    monkeypatch.setattr(preparing, "log_cluster_of", lambda token: "log")
    assert preparing.prepare([*verb, *AT, "--data-dir", str(tmp_path / "s9"), "--output", "json"]) == 0
    require_fields(f"supernode {verb[0]}", capsys.readouterr().out)


def test_an_address_beyond_loopback_needs_a_certificate_or_a_flag_and_the_error_names_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert preparing.prepare(["init", "--listen", "10.0.0.11:7590", "--data-dir", str(tmp_path / "s1")]) == 0
    *_, start, empty, printed = capsys.readouterr().out.splitlines()
    assert start.startswith("  stampede supernode --listen 10.0.0.11:7590 ")
    assert empty == ""
    assert "--tls-ca" in printed
    assert "--allow-insecure-anywhere" in printed
