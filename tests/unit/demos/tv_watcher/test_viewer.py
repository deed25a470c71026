"""The viewer's loop ends with the programme. If the group never reaches this end, the viewer says so."""

import threading
import time
from types import SimpleNamespace

import pytest

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.tv_watcher.programme import STREAMS
from stampede_rt_demos.tv_watcher.viewer import watch

HOUR_NANOS = 3_600_000_000_000


class Cuts:
    """A subscription that brings these cuts, without an item, and then nothing until it is closed."""

    def __init__(self, *times: int) -> None:
        self._times = list(times)
        self._closed = threading.Event()

    def close(self) -> None:
        self._closed.set()

    def __iter__(self) -> "Cuts":
        return self

    def __next__(self) -> "Cut":
        if self._times:
            return Cut(self._times.pop(0))
        self._closed.wait()
        raise StopIteration


class Cut:
    """A cut at which nothing became visible."""

    def __init__(self, at: int) -> None:
        self.time = at
        self.incomplete = ()
        self._nothing = dict.fromkeys((stream.channel for stream in STREAMS), Nothing())

    def __getitem__(self, channel: str) -> "Nothing":
        return self._nothing[channel]


class Nothing(tuple):
    """No items, and none are missing."""

    truncated = False


def test_the_viewer_ends_when_the_cut_has_reached_the_end_of_the_programme():
    until = time.time_ns() + HOUR_NANOS
    assert list(watch(SimpleNamespace(), Cuts(until - 1, until), until)) == []


def test_a_group_that_never_reaches_the_end_of_the_programme_is_reported():
    until = time.time_ns() - HOUR_NANOS
    with pytest.raises(DemoFailed, match="the group tv/programme did not come to the programme's end"):
        watch(SimpleNamespace(), Cuts(), until)
