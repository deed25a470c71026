"""`stampede certs` replaces its own files, and nothing else that has their names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from stampede_rt_runtime.certificates import CertificateError
from stampede_rt_runtime.certs_command import main, serial_of


@pytest.mark.parametrize("name", ["client-anna.pem", "client-anna.key"])
def test_a_pipe_at_the_path_of_a_file_is_not_replaced(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    authority, out = tmp_path / "certs", tmp_path / "out"
    assert main(["init", str(authority), "--cluster", "c"]) == 0
    out.mkdir()
    os.mkfifo(out / name)
    words = ["issue", "--role", "client", "--name", "anna", "--dir", str(authority), "--out", str(out)]
    assert main(words) == 1
    assert f"{out / name} is not a regular file" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == [name]
    assert (out / name).is_fifo()


@pytest.mark.parametrize("text", ["0786C71636B2", "07:86:C7:16:36:B2", "786c71636b2"])
def test_a_serial_number_can_be_given_in_the_forms_that_other_programs_print(text: str) -> None:
    assert serial_of(text) == "786c71636b2"


@pytest.mark.parametrize("text", ["", "0", "xyz", "1" * 65])
def test_a_malformed_serial_number_is_refused(text: str) -> None:
    with pytest.raises(CertificateError, match="neither a file nor a serial number"):
        serial_of(text)
