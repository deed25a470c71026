"""A store behind a guard: while it fails, one call tries it, and the others fail immediately."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator

import pytest

from stampede_rt_channel_host.archive.objects.guarded_store import PAUSE_SECONDS, GuardedStore
from stampede_rt_channel_host.archive.objects.segment_store import FoundObject, StoreError
from tests.support.channel_host.object_stores import FakeStore


class Times:
    """A clock in seconds that a test moves."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_a_store_that_fails_is_asked_again_only_after_a_pause() -> None:
    store, clock = FakeStore(), Times()
    guarded = GuardedStore(store, clock)
    store.objects["a"] = b"0123"
    store.failure = "connection refused"
    for _ in range(3):
        with pytest.raises(StoreError, match="connection refused"):
            guarded.read("a", 0, 4)
    assert store.calls == ["read a"]
    assert guarded.failure == "connection refused"
    clock.now += PAUSE_SECONDS
    with pytest.raises(StoreError):
        [*guarded.find("")]
    store.failure = ""
    with pytest.raises(StoreError):
        guarded.delete(["b"])
    clock.now += PAUSE_SECONDS
    assert guarded.read("a", 1, 2) == b"12"
    assert [*guarded.find("")] == [FoundObject("a", 4)]
    assert guarded.failure == ""


def test_a_missing_object_and_an_abandoned_listing_are_not_failures_of_the_store() -> None:
    store = FakeStore()
    store.objects.update({"a": b"1", "b": b"2"})
    guarded = GuardedStore(store)
    with pytest.raises(FileNotFoundError):
        guarded.read("missing", 0, 1)
    listing: Iterator[FoundObject] = guarded.find("")
    assert next(listing) == FoundObject("a", 1)
    del listing
    assert guarded.failure == ""
    assert guarded.read("b", 0, 1) == b"2"


def test_other_calls_do_not_wait_while_one_call_tries_a_store_that_hangs() -> None:
    started, answers = threading.Event(), threading.Event()

    class HangingStore(FakeStore):
        def read(self, name: str, offset: int, size: int) -> bytes:
            if self.failure:
                return super().read(name, offset, size)
            started.set()
            answers.wait(10)
            return b"x"

    store, clock = HangingStore(), Times()
    guarded = GuardedStore(store, clock)
    store.failure = "unreachable"
    with pytest.raises(StoreError):
        guarded.read("a", 0, 1)
    store.failure = ""
    clock.now += PAUSE_SECONDS
    trying = threading.Thread(target=guarded.read, args=("a", 0, 1))
    trying.start()
    assert started.wait(10)
    clock.now += 100 * PAUSE_SECONDS
    with pytest.raises(StoreError, match="unreachable"):
        guarded.read("a", 0, 1)
    answers.set()
    trying.join(10)
    assert guarded.read("a", 0, 1) == b"x"


@pytest.mark.asyncio
async def test_a_store_that_refuses_to_make_or_delete_objects_can_still_be_read() -> None:
    class ReadOnly(FakeStore):
        def _call(self, what: str) -> None:
            super()._call(what)
            if not what.startswith("read"):
                raise StoreError("AccessDenied", is_refusal=True)

    store = ReadOnly()
    store.objects["a"] = b"1"
    guarded = GuardedStore(store, Times())
    with pytest.raises(StoreError):
        guarded.delete(["b"])
    assert guarded.read("a", 0, 1) == b"1"
    with pytest.raises(StoreError):
        await guarded.create("c", b"1")
    assert guarded.failure == "AccessDenied"
    assert guarded.read("a", 0, 1) == b"1"


@pytest.mark.asyncio
async def test_an_upload_is_always_tried_and_readers_try_only_if_the_last_upload_succeeded() -> None:
    class HangingStore(FakeStore):
        async def create(self, name: str, content: bytes | bytearray) -> bool:
            if name == "hangs":
                await asyncio.Event().wait()
            return await super().create(name, content)

    store = HangingStore()
    guarded = GuardedStore(store, Times())
    store.failure = "unreachable"
    with pytest.raises(StoreError):
        await guarded.create("a", b"1")
    store.failure = ""
    assert await guarded.create("a", b"1")
    assert guarded.read("a", 0, 1) == b"1"
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.01):
            await guarded.create("hangs", b"1")
    with pytest.raises(StoreError, match="does not answer in time"):
        guarded.read("a", 0, 1)
