"""A backup reaches its file whole and checked, or not at all."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from stampede_rt.cli.backup_file import write_backup
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1.membership_service_pb2 import TakeSnapshotResponse

BODY = b"what was known" * 1000
SHA256 = hashlib.sha256(BODY).digest()
FACTS = TakeSnapshotResponse(supernode_id="s1", size_bytes=len(BODY) + 32, sha256=SHA256)


def responses(data: bytes, part_bytes: int = 999) -> Iterator[TakeSnapshotResponse]:
    yield FACTS
    for start in range(0, len(data), part_bytes):
        yield TakeSnapshotResponse(data=data[start : start + part_bytes])


@pytest.mark.parametrize("part_bytes", [7, 999, 10**6])
def test_a_whole_backup_replaces_the_former_file(tmp_path: Path, part_bytes: int) -> None:
    out = tmp_path / "backup"
    out.write_bytes(b"older")
    assert write_backup(responses(BODY + SHA256, part_bytes), out) == FACTS
    assert out.read_bytes() == BODY + SHA256
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("data", [b"", BODY, BODY[1:] + SHA256, b"W" + BODY[1:] + SHA256, BODY + bytes(32)])
def test_a_damaged_backup_does_not_replace_the_former_file(tmp_path: Path, data: bytes) -> None:
    out = tmp_path / "backup"
    out.write_bytes(b"older")
    with pytest.raises(StampedeError, match="the received backup is damaged"):
        write_backup(responses(data), out)
    assert out.read_bytes() == b"older"
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_only_a_regular_file_is_replaced_and_nothing_is_fetched_for_another_one(
    tmp_path: Path, make: Callable[[Path], None]
) -> None:
    out = tmp_path / "backup"
    make(out)
    request = responses(BODY + SHA256)
    with pytest.raises(StampedeError, match="not a regular file"):
        write_backup(request, out)
    assert next(request) == FACTS, "no response was taken"
    assert not out.is_file()
    assert list(tmp_path.iterdir()) == [out]


def test_an_error_of_the_disk_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_backup(responses(BODY + SHA256), tmp_path / "backup")
    assert caught.value.filename == str(tmp_path / "backup")
    assert list(tmp_path.iterdir()) == []


def test_a_broken_connection_leaves_no_backup_file(tmp_path: Path) -> None:
    def broken() -> Iterator[TakeSnapshotResponse]:
        yield FACTS
        raise Unavailable("gone")

    with pytest.raises(Unavailable):
        write_backup(broken(), tmp_path / "backup")
    assert list(tmp_path.iterdir()) == []
