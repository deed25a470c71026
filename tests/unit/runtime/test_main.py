"""The start and the exit status of a service."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.listen import check_listen
from stampede_rt_runtime.main import announce, run_service
from stampede_rt_runtime.service_settings import ServiceSettings
from stampede_rt_runtime.settings import setting

WHAT = ("", "fail", "listen", "file", "defect", "7")


@dataclass(frozen=True, kw_only=True)
class Settings(ServiceSettings):
    """A service for tests."""

    what: str = field(
        default="", metadata=setting(help="what to do", choices=("", "fail", "listen", "file", "defect", "7"))
    )


@pytest.fixture(autouse=True)
def _logging_as_before() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers = []
    yield
    root.handlers = handlers
    root.setLevel(level)


async def serve(settings: Settings) -> int | None:
    if settings.what == "fail":
        raise Unavailable("the supernodes are unreachable")
    if settings.what == "listen":
        check_listen("192.0.2.1:0", allow_insecure_anywhere=settings.allow_insecure_anywhere)
    if settings.what == "file":
        os.mkdir("/nowhere/at/all")
    if settings.what == "defect":
        raise OSError("not about a file")
    announce(f"served on {type(asyncio.get_running_loop()).__module__}")
    return int(settings.what) if settings.what else None


def test_a_service_ignores_the_certificate_settings_of_clients_and_logs_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("STAMPEDE_TLS_CERTIFICATE", "/nowhere/client.pem")
    assert run_service(Settings, "sample", (), serve) == 0
    logged = capsys.readouterr().err
    assert "this service uses no certificates: only clients use $STAMPEDE_TLS_CERTIFICATE;" in logged
    assert "$STAMPEDE_SAMPLE_TLS_CA" in logged
    monkeypatch.setenv("STAMPEDE_SAMPLE_TLS_CERTIFICATE", "/nowhere/own.pem")
    assert run_service(Settings, "sample", (), lambda settings: serve(_with_certificates(settings))) == 2
    assert "--tls-ca and --tls-key must be given, too" in capsys.readouterr().err


def _with_certificates(settings: Settings) -> Settings:
    settings.load_tls(Role.HOST)
    return settings


@pytest.mark.parametrize(
    ("argv", "code", "complaint"),
    [
        ((), 0, ""),
        (("--what", "7"), 7, ""),
        (("--what", "9"), 2, "stampede sample: --what: '9' cannot be used; allowed: , fail, listen, file, defect, 7\n"),
        (("--what", "fail"), 1, "stampede sample: the supernodes are unreachable\n"),
        (("--what", "file"), 1, "stampede sample: /nowhere/at/all cannot be used: No such file or directory\n"),
        (("--secret-file", "/nowhere/secret"), 1, None),
    ],
)
def test_a_service_ends_with_a_code_and_at_most_one_line(
    argv: tuple[str, ...], code: int, complaint: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    async def with_secret(settings: Settings) -> int | None:
        if settings.secret_file is not None:
            settings.load_secret()
        return await serve(settings)

    assert run_service(Settings, "sample", argv, with_secret) == code
    error_output = capsys.readouterr().err
    assert error_output.count("\n") <= 1
    assert "Traceback" not in error_output
    if complaint is not None:
        assert error_output == complaint


def test_a_service_raises_an_unexpected_error() -> None:
    with pytest.raises(OSError, match="not about a file"):
        run_service(Settings, "sample", ["--what", "defect"], serve)


def test_listening_beyond_loopback_needs_its_flag(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_service(Settings, "sample", ["--what", "listen"], serve) == 2
    assert "--allow-insecure-anywhere" in capsys.readouterr().err


def test_a_service_that_cannot_listen_at_its_address_ends_with_code_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_service(Settings, "sample", ["--what", "listen", "--allow-insecure-anywhere"], serve) == 1
    assert "is not an address of this machine" in capsys.readouterr().err


def test_help_goes_to_standard_output_and_ends_with_code_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_service(Settings, "sample", ["--help"], serve) == 0
    output = capsys.readouterr()
    assert "usage: stampede sample" in output.out
    assert output.err == ""


def test_services_run_on_uvloop(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("uvloop")
    assert run_service(Settings, "sample", (), serve) == 0
    assert "served on uvloop" in capsys.readouterr().out
