"""Errors of reads and writes name the file, although an open file does not know its name."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from stampede_rt_channel_host.cluster.identity import load_host_id
from stampede_rt_runtime.auth import make_secret_file
from stampede_rt_runtime.written import naming
from stampede_rt_supernode.joining.founding import FILE_NAME, FoundingRecord, write_founding


def no_room(_descriptor: int) -> None:
    raise OSError(28, "No space left on device")


def test_the_name_of_the_folder_is_added_to_an_error_without_a_file_name() -> None:
    with pytest.raises(OSError, match="No space left") as raised, naming("/a/file"):
        no_room(0)
    assert raised.value.filename == "/a/file"
    with pytest.raises(FileNotFoundError) as missing, naming("/a/file"):
        os.stat("/nowhere/at/all")
    assert missing.value.filename == "/nowhere/at/all"


def test_a_host_or_supernode_whose_folder_is_on_a_full_disk_names_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("os.fsync", no_room)
    with pytest.raises(OSError, match="host-id"):
        load_host_id(tmp_path / "h")
    founding = FoundingRecord(supernode_id="s1", address="localhost:1", members={})
    with pytest.raises(OSError, match=FILE_NAME):
        write_founding(tmp_path / "s", founding)
    assert make_secret_file(tmp_path / "secret").text
