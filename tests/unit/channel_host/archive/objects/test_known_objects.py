"""The list of a channel's objects on the disk: after changes, after damage, and on a disk that takes nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.objects import known_objects
from stampede_rt_channel_host.archive.objects.known_objects import KnownObjects, ObjectListing

URL = "s3://bucket/a prefix"


def test_a_list_of_objects_shows_the_additions_and_removals(tmp_path: Path) -> None:
    known = KnownObjects(tmp_path, URL)
    assert known.read() is None
    known.add({"a": 1})  # there is no list yet to which this object could be added
    assert known.read() is None
    known.replace(ObjectListing(3, {"a": 1, "b": 2}))
    known.add({"c d": 3, "b": 4})
    known.remove(["a"])
    assert KnownObjects(tmp_path, URL).read() == ObjectListing(3, {"b": 4, "c d": 3})
    known.drop(["b"], 7)
    assert known.read() == ObjectListing(3, {"c d": 3}, 7)
    known.replace(ObjectListing(3, {"c d": 3}, 7))
    assert known.read() == ObjectListing(3, {"c d": 3}, 7)
    known.replace(ObjectListing(4, {}))
    assert known.read() == ObjectListing(4, {})
    assert KnownObjects(tmp_path, "s3://another/bucket").read() is None
    assert [path.name for path in tmp_path.iterdir()] == ["objects"]


def test_a_list_that_ends_within_a_line_counts_as_missing_until_the_host_writes_it_again(tmp_path: Path) -> None:
    known, file = KnownObjects(tmp_path, URL), tmp_path / "objects"
    known.replace(ObjectListing(1, {"a": 1}))
    known.add({"b": 2})
    whole = file.read_bytes()
    ends = {at + 1 for at, byte in enumerate(whole) if byte == ord("\n")}
    for size in range(len(whole)):
        file.write_bytes(whole[:size])
        assert (known.read() is not None) == (size in ends)
        known.replace(ObjectListing(1, {"z": 9}))
        assert known.read() == ObjectListing(1, {"z": 9})


def test_a_list_with_a_flipped_bit_counts_as_missing(tmp_path: Path) -> None:
    known, file = KnownObjects(tmp_path, URL), tmp_path / "objects"
    known.replace(ObjectListing(1, {"a": 1, "b": 2}))
    good = file.read_bytes()
    for at in range(len(good)):
        for bit in range(8):
            file.write_bytes(good[:at] + bytes([good[at] ^ (1 << bit)]) + good[at + 1 :])
            assert known.read() is None


@pytest.mark.parametrize("change", ["replace", "add"])
def test_a_move_succeeds_even_if_the_disk_cannot_store_the_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "no space left on device")

    known = KnownObjects(tmp_path, URL)
    known.replace(ObjectListing(1, {"a": 1}))
    monkeypatch.setattr(known_objects, "write_all", full)
    if change == "replace":
        known.replace(ObjectListing(2, {}))
    else:
        known.add({"b": 2})
    assert known.read() is None
    assert [*tmp_path.iterdir()] == []
