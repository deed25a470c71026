"""The errors of files that cannot be written."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from stampede_rt.errors import FileError
from stampede_rt.files.editing import cut, recover
from stampede_rt.files.merging import merge
from stampede_rt.files.writing import write_fault
from tests.support.files.recordings import entries, write

COMMANDS: dict[str, Callable[[Path, Path], object]] = {
    "cut": lambda path, output: cut(path, output, start=0, end=2**62),
    "recover": recover,
    "merge": lambda path, output: merge([path], output),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_the_error_of_a_full_disk_names_no_file_that_does_not_stay(
    tmp_path: Path, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, output = write(tmp_path / "a.mcap", entries("cam", [1, 2])), tmp_path / "b.mcap"

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileError) as raised:
        COMMANDS[command](path, output)
    assert raised.value.message == (
        f"the file {str(output)!r} cannot be written: No space left on device; free space; no new file was written"
    )
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]


def test_the_error_of_a_recording_on_a_full_disk_names_the_command_that_reads_the_items_so_far() -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert "`stampede file recover` reads the items" in write_fault("drive.mcap", full).message
