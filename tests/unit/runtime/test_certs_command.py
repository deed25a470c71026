"""`stampede certs` replaces its own files, and nothing else that has their names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from stampede_rt_runtime.certs_command import main


@pytest.mark.parametrize("name", ["client-anna.pem", "client-anna.key"])
def test_a_pipe_in_the_place_of_a_file_is_not_replaced(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    authority, out = tmp_path / "certs", tmp_path / "out"
    assert main(["init", str(authority), "--cluster", "c"]) == 0
    out.mkdir()
    os.mkfifo(out / name)
    words = ["issue", "--role", "client", "--name", "anna", "--dir", str(authority), "--out", str(out)]
    assert main(words) == 1
    assert f"{out / name} is no regular file" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == [name]
    assert (out / name).is_fifo()
