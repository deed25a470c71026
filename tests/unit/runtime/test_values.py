"""The texts of addresses, durations and sizes."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_runtime import archive_places
from stampede_rt_runtime.archive_places import check_archive, default_folder, folder_of, parse_archive
from stampede_rt_runtime.values import (
    Address,
    format_size,
    parse_address,
    parse_bool,
    parse_duration,
    parse_list,
    parse_size,
    parse_target,
)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("localhost:7580", Address("localhost", 7580)),
        (" 127.0.0.1:0 ", Address("127.0.0.1", 0)),
        ("[::1]:65535", Address("::1", 65535)),
    ],
)
def test_an_address_is_a_host_and_a_port(text: str, address: Address) -> None:
    assert parse_address(text) == address
    assert str(address) == text.strip()


@pytest.mark.parametrize(
    "text",
    ["", ":", "localhost", "localhost:", ":80", "::1:80", "[]:80", "a b:80", "a:65536", "a:-1", "a:8O", "http://a:80",
     "a:²", "[::1:80", "::1]:80"],
)  # fmt: skip
def test_other_texts_are_not_addresses(text: str) -> None:
    with pytest.raises(ValueError, match="HOST:PORT"):
        parse_address(text)


def test_port_0_cannot_be_called() -> None:
    with pytest.raises(ValueError, match="from 1 to 65535"):
        parse_target("localhost:0")


@pytest.mark.parametrize(
    ("text", "nanos"), [("0s", 0), ("30ms", 30_000_000), (" 1.5 s ", 1_500_000_000), ("2m", 120_000_000_000)]
)
def test_a_duration_is_in_nanoseconds(text: str, nanos: int) -> None:
    assert parse_duration(text) == nanos


@pytest.mark.parametrize("text", ["", "5", "-5s", "5 weeks", "s", "1e3s", "nan s"])
def test_a_duration_needs_a_number_and_a_unit(text: str) -> None:
    with pytest.raises(ValueError, match="a duration with its unit"):
        parse_duration(text)


@pytest.mark.parametrize(("text", "bytes_"), [("0", 0), ("10", 10), ("3B", 3), ("64KiB", 65536), ("20 MiB", 20 << 20)])
def test_a_size_is_in_bytes(text: str, bytes_: int) -> None:
    assert parse_size(text) == bytes_


@given(st.integers(0, 2**40), st.integers(0, 3))
def test_a_formatted_size_parses_to_itself(count: int, unit: int) -> None:
    assert parse_size(format_size(count << (10 * unit))) == count << (10 * unit)


@pytest.mark.parametrize("text", ["", "-1", "1KB", "1.5MiB", "MiB"])
def test_a_size_needs_a_known_unit(text: str) -> None:
    with pytest.raises(ValueError, match="a number of bytes"):
        parse_size(text)


@pytest.mark.parametrize(("text", "value"), [("1", True), ("Yes", True), ("on", True), ("0", False), ("FALSE", False)])
def test_a_boolean_may_be_written_in_the_usual_words(text: str, value: bool) -> None:
    assert parse_bool(text) is value


def test_a_list_may_have_spaces_and_empty_entries() -> None:
    assert parse_list(parse_target)(" a:1, b:2,, ") == ("a:1", "b:2")
    assert parse_list(parse_target)("") == ()


@pytest.mark.parametrize("text", ["s3://bucket/rig", "s3://bucket", "gs://b/p", "az://c/p", "file:///mnt/nas"])
def test_the_url_of_an_object_store_is_not_made_a_path(text: str) -> None:
    assert parse_archive(text) == text
    assert parse_archive(f" {text}/ ") == text


def test_a_text_that_is_no_url_is_a_folder() -> None:
    assert parse_archive("/data/archive") == Path("/data/archive")
    assert parse_archive("archive") == Path("archive")


@pytest.mark.parametrize(
    "text", ["s3://key:secret@bucket/p", "s3://b/p?versionId=1", "s3://b/p#x", "az://c/p?sig=abc", "s3://user@b/p"]
)
def test_a_url_with_credentials_or_options_is_refused_and_the_error_does_not_repeat_it(text: str) -> None:
    with pytest.raises(ValueError, match="without credentials") as caught:
        parse_archive(text)
    assert text not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["ftp://host/p", "http://host/p", "s3://", "s3:///p", "file://", "file:///", "memory:///"]
)
def test_an_unknown_or_incomplete_url_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="s3://BUCKET/PREFIX"):
        parse_archive(text)


def test_the_folder_beside_an_object_store_defaults_to_the_data_folder_or_the_users_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert folder_of(None, None, Path("d")) is None
    assert folder_of(Path("a"), None, Path("d")) == Path("a")
    assert folder_of("s3://b", Path("f"), Path("d")) == Path("f")
    assert folder_of("s3://b", None, Path("d")) == Path("d/archive")
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert folder_of("s3://b", None, None) == default_folder() == Path("/state/stampede/archive")
    monkeypatch.delenv("XDG_STATE_HOME")
    assert default_folder() == Path.home() / ".local/state/stampede/archive"


def test_a_folder_for_an_object_store_without_one_is_refused() -> None:
    check_archive("s3://b", Path("f"))
    with pytest.raises(ValueError, match="give the URL of the store"):
        check_archive(Path("a"), Path("f"))


def test_a_url_without_the_extra_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive_places, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"extra \[objects\]"):
        check_archive("s3://b", None)
