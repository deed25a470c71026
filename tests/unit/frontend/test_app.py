"""The start of a front-end with bad settings."""

from __future__ import annotations

import pytest

from stampede_rt_frontend.app import main


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ((), "--supernodes is missing"),
        (("--supernodes", ","), "--supernodes names 0 supernodes; allowed: 1 to 64"),
        (("--supernodes", "here"), "--supernodes: 'here' cannot be used; allowed: HOST:PORT"),
        (("--supernodes", "a:1", "--listen", "0.0.0.0:0"), "--allow-insecure-anywhere"),
    ],
)
def test_a_front_end_with_bad_settings_prints_one_line_and_exits_with_2(
    argv: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt_runtime.main.set_up_logging", lambda level, form: None)
    assert main(argv) == 2
    error_output = capsys.readouterr().err
    assert error_output.startswith("stampede frontend: ")
    assert message in error_output
    assert error_output.count("\n") == 1
