"""The audit log."""

from __future__ import annotations

import pytest

from stampede_rt_runtime.access.audit import CALLERS_MAX, AuditLog
from stampede_rt_runtime.access.caller import Caller, CallerKind
from stampede_rt_runtime.identity import Role

CAM = Caller(kind=CallerKind.TOKEN, roles=frozenset({Role.CLIENT}), name="cam", serial="a1")


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_an_audit_line_names_the_caller_the_action_and_the_address(caplog: pytest.LogCaptureFixture) -> None:
    AuditLog().denied(CAM, "ipv4:10.0.0.3:5", "put", "channel video")
    [line] = caplog.records
    facts = {key: vars(line)[key] for key in ("who", "proof", "serial", "address", "verb", "thing", "result")}
    assert facts == {
        "who": "cam",
        "proof": "token",
        "serial": "a1",
        "address": "ipv4:10.0.0.3:5",
        "verb": "put",
        "thing": "channel video",
        "result": "denied",
    }


def test_repeated_denials_of_one_caller_make_one_line_a_second_with_their_number(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = Clock()
    log = AuditLog(clock)
    for _ in range(1000):
        log.denied(CAM, "ipv4:10.0.0.3:5", "put", "channel video")
    log.denied(None, "ipv4:10.0.0.4:5", "DirectoryService/OpenChannel", "")
    clock.now = 1.0
    log.denied(CAM, "ipv4:10.0.0.3:5", "put", "channel video")
    assert [(vars(one)["who"], vars(one)["left_out"]) for one in caplog.records] == [("cam", 0), ("", 0), ("cam", 999)]
    assert log.denials == 1002


def test_a_caller_without_a_credential_is_named_by_its_machine_not_by_each_of_its_ports(
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = AuditLog(Clock())
    for port in range(100):
        log.denied(None, f"ipv4:10.0.0.4:{port}", "DirectoryService/OpenChannel", "")
    assert len(caplog.records) == 1


def test_the_callers_that_the_audit_log_remembers_are_bounded() -> None:
    log = AuditLog(Clock())
    for number in range(2 * CALLERS_MAX):
        log.denied(None, f"ipv4:10.0.{number // 256}.{number % 256}:5", "x", "")
    assert len(log._last) == CALLERS_MAX


def test_an_address_of_ipv6_is_written_with_its_brackets(caplog: pytest.LogCaptureFixture) -> None:
    AuditLog().denied(CAM, "ipv6:%5B::1%5D:5", "put", "channel video")
    assert [vars(one)["address"] for one in caplog.records] == ["ipv6:[::1]:5"]


def test_changes_are_always_reported(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    log = AuditLog(Clock())
    for number in range(3):
        log.changed(CAM, "ipv4:10.0.0.3:5", "add rule", str(number))
    assert [vars(one)["thing"] for one in caplog.records] == ["0", "1", "2"]
    log.changed(CAM, "ipv4:10.0.0.3:5", "remove rule", "missing", done=False)
    assert [vars(one)["result"] for one in caplog.records] == ["done", "done", "done", "unchanged"]
