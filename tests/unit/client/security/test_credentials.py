"""The file of a secret or token, which others replace while a client uses it."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from stampede_rt.cluster.call_metadata import CallMetadata
from stampede_rt.cluster.connecting import parse_target
from stampede_rt.errors import PermissionDenied
from stampede_rt.pickling import ClusterReference
from stampede_rt.security import credentials
from stampede_rt.security.credentials import SecretReader


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return written(tmp_path / "token", "first")


def written(path: Path, text: str, mode: int = 0o600) -> Path:
    new = path.with_suffix(".new")
    new.write_text(text)
    new.chmod(mode)
    return new.rename(path)


def test_a_reader_gives_the_present_contents_and_looks_at_most_once_a_second(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = SecretReader(path)
    now_s = reader._looked_s
    monkeypatch.setattr(credentials.time, "monotonic", lambda: now_s)
    written(path, "second")
    assert reader.current() == "first"
    now_s += credentials.LOOK_EVERY_S
    assert reader.current() == "second"


def test_a_change_that_cannot_be_used_is_reported_once_and_the_last_good_secret_stays(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(credentials, "LOOK_EVERY_S", 0.0)
    reader = SecretReader(path)
    with caplog.at_level(logging.WARNING):
        written(path, "for all to read", 0o644)
        assert [reader.current() for _ in range(3)] == ["first"] * 3
    assert len(caplog.records) == 1
    assert "can be read by every user" in caplog.records[0].getMessage()
    for _ in range(2):
        written(path, "")  # another process is writing the file
        assert reader.current() == "first"
        path.unlink()
        assert reader.current() == "first"
    written(path, "second")
    assert reader.current() == "second"


def test_a_file_that_is_created_later_is_read_too(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(credentials, "LOOK_EVERY_S", 0.0)
    path.unlink()
    reader = SecretReader(path)
    assert reader.current() is None
    written(path, "first")
    assert reader.current() == "first"


def test_each_call_carries_the_present_secret_and_the_cluster(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(credentials, "LOOK_EVERY_S", 0.0)
    target = parse_target("elsewhere:1", name=None, secret=path, zone=None)
    metadata = CallMetadata(target.credentials.present_secret)
    metadata.cluster_id = "c"
    first = metadata()
    written(path, "second")
    assert ("authorization", "Bearer first") in first
    assert metadata() == (("authorization", "Bearer second"), *first[1:])
    assert "first" not in repr(target)


def test_a_path_without_a_secret_is_refused(path: Path) -> None:
    for text in (None, ""):
        path.unlink() if text is None else written(path, text)
        with pytest.raises(PermissionDenied, match="holds no secret or token"):
            parse_target("localhost:1", name=None, secret=path, zone=None)


def test_a_connection_with_the_path_of_a_secret_can_be_pickled(path: Path) -> None:
    reference = ClusterReference.of(parse_target("elsewhere:1", name=None, secret=path, zone=None), path)
    make, arguments = reference.__reduce__()
    assert make(*arguments) == reference
    assert reference.secret_path == str(path)
