"""The puts that share a stream, and the puts that do not share one."""

from __future__ import annotations

import pytest

from stampede_rt._async.put_streams import Owner, PutStreams
from stampede_rt.cluster.binding import Binding


class Exchange:
    """A stream that does nothing."""

    def __init__(self, *, one_at_a_time: bool = False) -> None:
        self.one_at_a_time = one_at_a_time
        self.broken = False
        self.is_outdated = False

    def cancel(self) -> None:
        self.broken = True


class OpenCounter:
    """Counts opened streams."""

    def __init__(self, *, one_at_a_time: bool = False) -> None:
        self.streams: list[Exchange] = []
        self._one_at_a_time = one_at_a_time

    def __call__(self) -> Exchange:
        self.streams.append(Exchange(one_at_a_time=self._one_at_a_time))
        return self.streams[-1]


class HandleOwner:
    """An object that has a handle."""


def binding_at(target: str, subject: bytes = b"channel") -> Binding:
    return Binding(subject_id=subject, target=target, epoch=1, incarnation=1)


def shared_owner(target: str) -> Owner:
    return "puts", target


def test_all_channels_of_a_host_share_a_stream_and_another_host_has_another_stream() -> None:
    streams, opened = PutStreams(), OpenCounter()
    for subject in (b"one", b"two", b"three"):
        for target in ("a:1", "b:1"):
            with streams.use(shared_owner(target), 0.0, binding_at(target, subject), opened):  # type: ignore[arg-type]
                pass
    assert len(opened.streams) == 2


async def test_a_channel_that_is_bound_anew_at_its_host_keeps_the_stream() -> None:
    streams, opened, owner = PutStreams(), OpenCounter(), HandleOwner()
    handle = streams.handle(owner)
    for epoch in (1, 2):
        binding = Binding(subject_id=b"channel", target="a:1", epoch=epoch, incarnation=1)
        with streams.use(handle, 5.0, binding, opened):  # type: ignore[arg-type]
            pass
    assert len(opened.streams) == 1


async def test_a_faster_stream_replaces_one_that_has_become_idle() -> None:
    streams, opened = PutStreams(), OpenCounter()
    with streams.use(shared_owner("a:1"), 5.0, binding_at("a:1"), opened) as first:  # type: ignore[arg-type]
        opened.streams[0].is_outdated = True
        with streams.use(shared_owner("a:1"), 5.0, binding_at("a:1"), opened) as second:  # type: ignore[arg-type]
            assert second is first
    assert not opened.streams[0].broken
    with streams.use(shared_owner("a:1"), 5.0, binding_at("a:1"), opened) as third:  # type: ignore[arg-type]
        assert third is not first
    assert [stream.broken for stream in opened.streams] == [True, False]


@pytest.mark.parametrize(("one_at_a_time", "streams_needed"), [(False, 1), (True, 3)])
def test_puts_under_way_together_share_a_stream_that_takes_several(one_at_a_time: bool, streams_needed: int) -> None:
    """In the blocking client a signal handler may put while its thread is in a put."""
    streams, opened = PutStreams(), OpenCounter(one_at_a_time=one_at_a_time)
    uses = [streams.use(shared_owner("a:1"), 0.0, binding_at("a:1"), opened) for _ in range(3)]  # type: ignore[arg-type]
    for use in uses:
        use.__enter__()
    for use in uses:
        use.__exit__(None, None, None)
    assert len(opened.streams) == streams_needed


async def test_a_handle_that_closes_closes_its_own_streams_only() -> None:
    streams, opened, owner = PutStreams(), OpenCounter(), HandleOwner()
    handle = streams.handle(owner)
    for one in (handle, shared_owner("a:1")):
        with streams.use(one, 5.0, binding_at("a:1"), opened):  # type: ignore[arg-type]
            pass
    streams.close(handle)
    assert [stream.broken for stream in opened.streams] == [True, False]
