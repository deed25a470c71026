"""Streams of XDF with unusual headers and times."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from stampede_rt.errors import FileError
from stampede_rt.files.entries import FileEntry
from stampede_rt.files.foreign import source_of
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from tests.support.files.foreign_files import xdf_file


def test_a_stream_without_a_type_has_no_attribute_for_it(tmp_path: Path) -> None:
    path = xdf_file(tmp_path / "a.xdf", [(1.0, [0.5])], [(1.0, "begin")])
    path.write_bytes(path.read_bytes().replace(b"<type>eeg</type>", b"<kind>eeg</kind>"))
    source = source_of(path)
    events = [event for _, event in source.events(lambda _: True, MIN_INSTANT, MAX_INSTANT)]
    assert [one.attributes for one in events if isinstance(one, FileEntry)] == [{}, {"type": "marks"}]


@pytest.mark.parametrize("time", [math.nan, math.inf])
def test_a_time_that_is_no_finite_number_is_damage(tmp_path: Path, time: float) -> None:
    path = xdf_file(tmp_path / "a.xdf", [(1.0, [0.5]), (time, [1.5])], [])
    with pytest.raises(FileError, match="a time of stream 'EEG' is no finite number"):
        source_of(path)


def test_a_sample_with_a_later_time_than_a_channel_can_have_is_not_left_out(tmp_path: Path) -> None:
    source = source_of(xdf_file(tmp_path / "a.xdf", [(1.0, [0.5]), (1e12, [1.5])], []))
    assert len([*source.events(lambda _: True, MIN_INSTANT, MAX_INSTANT)]) == 2
