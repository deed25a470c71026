"""The messages of a service to its supervisor."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from stampede_rt_runtime.supervision.systemd import READY, notify_systemd, without_supervisor


@pytest.mark.parametrize("abstract", [False, True])
def test_a_service_reports_its_state_to_the_supervisor_at_a_path_or_an_abstract_name(
    abstract: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"@stampede{tmp_path}" if abstract else str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", name)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind("\0" + name[1:] if abstract else name)
        notify_systemd(READY)
        assert one.recv(100, socket.MSG_DONTWAIT) == b"READY=1"


def test_a_missing_supervisor_is_only_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    notify_systemd(READY)
    assert [record.__dict__["event"] for record in caplog.records] == ["supervisor_not_told"]


def test_without_a_supervisor_nothing_is_reported(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notify_systemd(READY)
    assert caplog.records == []


def test_a_child_process_does_not_inherit_the_supervisors_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/notify")
    assert "NOTIFY_SOCKET" not in without_supervisor()
