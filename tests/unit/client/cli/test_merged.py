"""`stampede sub` and channels that are deleted and made again, with a connection whose answers the test sets."""

from __future__ import annotations

import argparse
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Queue
from typing import Any

from stampede_rt.cli.merged import _Stream
from stampede_rt.errors import ChannelNotFound
from stampede_rt.values.model import Change, ChannelInfo, Item, Policy
from tests.support.waiting import wait_until


def info(channel_id: bytes) -> ChannelInfo:
    return ChannelInfo(
        channel_id=channel_id, name="cam", host_id=b"h", host="host", host_alive=True, epoch=1, incarnation=1,
        policy=Policy(), spec_version=1,
    )  # fmt: skip


def item(payload: bytes) -> Item:
    return Item(
        time=1, end=None, duration=None, seq=1, payload=payload, payload_length_bytes=len(payload), attributes={},
        content_type="", incarnation=0,
    )  # fmt: skip


class FakeConnection:
    """A directory and a host. They return the changes and items of the test, and raise its errors."""

    def __init__(self, listed: list[ChannelInfo]) -> None:
        self.listed = listed
        self.changes: Queue[Any] = Queue()
        self.incarnations: Queue[Queue[Any]] = Queue()  # one queue of items for each subscription

    @contextmanager
    def watch(self, glob: str) -> Iterator[Iterator[Change]]:
        yield _entries_of(self.changes)

    def channels(self, glob: str) -> list[ChannelInfo]:
        return self.listed

    def channel(self, name: str, *, create: bool) -> FakeConnection:
        return self

    @contextmanager
    def subscribe(self, start: Any, *, payloads: bool) -> Iterator[FakeSubscription]:
        yield FakeSubscription(self.incarnations.get())


class FakeSubscription:
    dropped = 0

    def __init__(self, items: Queue[Any]) -> None:
        self._items = items

    def __iter__(self) -> Iterator[Any]:
        return _entries_of(self._items)


def _entries_of(queue: Queue[Any]) -> Iterator[Any]:
    while True:
        one = queue.get()
        if isinstance(one, Exception):
            raise one
        yield one


def queue_of(*entries: Any) -> Queue[Any]:
    queue: Queue[Any] = Queue()
    for entry in entries:
        queue.put(entry)
    return queue


def stream_of(rt: FakeConnection) -> _Stream:
    arguments = argparse.Namespace(glob="*", start=None, no_payloads=False, wait=0.0)
    stream = _Stream(rt, arguments)  # type: ignore[arg-type]
    threading.Thread(target=stream.follow, daemon=True).start()
    return stream


def test_a_channel_that_is_made_again_before_its_reader_learns_of_the_deletion_is_read_again() -> None:
    rt = FakeConnection([info(b"1")])
    former = queue_of(item(b"former"))
    rt.incarnations.put(former)
    stream = stream_of(rt)
    items = stream.items()
    assert next(items).item.payload == b"former"
    rt.changes.put(Change(index=2, kind="removed", subject=info(b"1")))
    rt.changes.put(Change(index=3, kind="added", subject=info(b"2")))
    rt.changes.put(Change(index=4, kind="updated", subject=info(b"2")))
    wait_until(rt.changes.empty)
    rt.incarnations.put(queue_of(item(b"latter")))
    former.put(ChannelNotFound("it is deleted"))
    assert next(items).item.payload == b"latter"
    stream.end()


def test_a_deleted_channel_is_not_read_until_the_directory_names_it_again() -> None:
    rt = FakeConnection([info(b"1")])
    rt.incarnations.put(queue_of(item(b"former"), ChannelNotFound("it is deleted")))
    stream = stream_of(rt)
    items = stream.items()
    assert next(items).item.payload == b"former"
    rt.incarnations.put(queue_of(item(b"latter")))
    rt.changes.put(Change(index=3, kind="added", subject=info(b"2")))
    assert next(items).item.payload == b"latter"
    stream.end()
