"""The stream between two hosts, without a network."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.errors import (
    HostNotFound,
    InvalidArgument,
    PermissionDenied,
    StampedeError,
    Unavailable,
    VersionMismatch,
)
from stampede_rt.v1 import group_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.core.group import CutFloor
from stampede_rt_channel_host.groups import link as link_module
from stampede_rt_channel_host.groups.link import ENTRIES_MAX, HostLink
from stampede_rt_channel_host.groups.sharing_hosts import _unwrapped

ME, OTHER = b"this-host-has-16", b"another-host-id!"


class Notebook:
    """Knows the times of each channel for which it is asked, and records all messages."""

    def __init__(self) -> None:
        self.newest = 1
        self.received: list[tuple[pb.TimesUpdate, bool]] = []
        self.requested_ids: list[set[bytes]] = []
        self.has_lease = True
        self.stands = asyncio.Event()
        self.names: dict[bytes, str] = {}

    def times_of(self, channel_id: bytes) -> group_pb2.ChannelTimes | None:
        return group_pb2.ChannelTimes(channel_id=channel_id, newest_unix_nano=self.newest)

    def floor_of(self, group_id: bytes) -> CutFloor | None:
        return CutFloor(group_id, 0, self.newest, 0)

    def receive(self, host_id: bytes, update: pb.TimesUpdate, *, is_first: bool) -> None:
        self.received.append((update, is_first))

    def name_of_host(self, host_id: bytes) -> str:
        return self.names.get(host_id, "")

    def greeted(self, link: HostLink) -> None:
        self.stands.set()

    def channels_requested(self, channel_ids: set[bytes]) -> None:
        self.requested_ids.append(channel_ids)

    def check_lease(self) -> None:
        if not self.has_lease:
            raise HostNotFound("no lease")


class Wire:
    """One link. The test has both ends."""

    def __init__(self, notebook: Notebook, certified_name: str = "") -> None:
        self.sent: asyncio.Queue[pb.ExchangeTimesRequest] = asyncio.Queue()
        self.incoming: asyncio.Queue[Any] = asyncio.Queue()
        self.may_write = asyncio.Event()
        self.may_write.set()
        identity = HostIdentity(host_id=ME, name="me", boot_incarnation=1)
        self.link = HostLink(
            identity, "c", notebook, pb.ExchangeTimesRequest, self._write, self.incoming.get, certified_name
        )
        self.running = asyncio.create_task(_unwrapped(self.link.run(OTHER)))

    async def _write(self, message: pb.ExchangeTimesRequest) -> None:
        await self.may_write.wait()
        self.sent.put_nowait(message)

    async def greet(self, **fields: Any) -> None:
        hello = {"cluster_id": "c", "host_id": OTHER, "boot_incarnation": 1, "protocol_version": 1, **fields}
        await self.incoming.put(pb.ExchangeTimesResponse(hello=pb.ExchangeHello(**hello)))
        assert (await self.sent.get()).hello.host_id == ME

    async def send(self, update: pb.TimesUpdate) -> None:
        await self.incoming.put(pb.ExchangeTimesResponse(update=update))

    async def end(self) -> None:
        await self.incoming.put(None)
        await self.running


async def test_the_other_host_gets_only_the_newest_state_of_its_wanted_channels() -> None:
    notebook = Notebook()
    wire = Wire(notebook)
    await wire.greet()
    assert (await wire.sent.get()).update == pb.TimesUpdate()
    wire.link.report_times(b"one")  # the other host has not asked for it
    await wire.send(pb.TimesUpdate(interest=pb.TimesInterest(channel_ids=[b"one", b"two"])))
    update = (await wire.sent.get()).update
    assert [times.channel_id for times in update.times] == [b"one", b"two"]
    wire.may_write.clear()
    for notebook.newest in range(2, 100):
        wire.link.report_times(b"one")
        wire.link.report_floor(b"group")
        await asyncio.sleep(0)
    wire.may_write.set()
    updates = [(await wire.sent.get()).update]
    while updates[-1].times[0].newest_unix_nano < 99:
        updates.append((await wire.sent.get()).update)
    assert len(updates) <= 2  # one message may have been under way; all later changes became one message
    assert [len(one.times) for one in updates] == [1] * len(updates)
    assert updates[-1].floors[0].cut_unix_nano == 99
    assert notebook.requested_ids == [{b"one", b"two"}]
    await wire.end()


async def test_a_link_reports_when_the_other_host_has_sent_its_whole_state() -> None:
    notebook = Notebook()
    wire = Wire(notebook)
    await wire.greet()
    await wire.send(pb.TimesUpdate(floors=[group_pb2.CutFloor(cut_unix_nano=1)] * ENTRIES_MAX))
    await wire.send(pb.TimesUpdate())
    await wire.send(pb.TimesUpdate())
    await wire.end()
    assert [is_first for _, is_first in notebook.received] == [False, True, False]


async def test_a_certificate_is_valid_only_for_the_host_that_it_names() -> None:
    notebook = Notebook()
    notebook.names[OTHER] = "h2"
    wire = Wire(notebook, certified_name="nobody")
    await wire.greet()
    with pytest.raises(PermissionDenied, match="belongs to host nobody, but the hello names host h2"):
        await wire.running
    own = Wire(notebook, certified_name="h2")
    await own.greet()
    await own.send(pb.TimesUpdate())
    await own.end()
    assert len(notebook.received) == 1


async def test_a_host_accepts_no_further_messages_under_an_outdated_host_name() -> None:
    notebook = Notebook()
    wire = Wire(notebook, certified_name="nobody")
    await wire.greet()
    await notebook.stands.wait()
    notebook.names[OTHER] = "h2"
    await wire.send(pb.TimesUpdate(floors=[group_pb2.CutFloor(cut_unix_nano=1)]))
    with pytest.raises(PermissionDenied):
        await wire.running
    assert notebook.received == []


@pytest.mark.parametrize(
    ("hello", "error"),
    [
        ({"protocol_version": 2}, VersionMismatch),
        ({"cluster_id": "another"}, InvalidArgument),
        ({"host_id": b"neither-of-them!"}, InvalidArgument),
    ],
)
async def test_a_link_to_the_wrong_host_is_refused(hello: dict[str, Any], error: type[StampedeError]) -> None:
    wire = Wire(Notebook())
    await wire.greet(**hello)
    with pytest.raises(error):
        await wire.running


async def test_a_link_without_a_greeting_is_refused() -> None:
    wire = Wire(Notebook())
    await wire.send(pb.TimesUpdate())
    with pytest.raises(InvalidArgument, match="hello"):
        await wire.running


async def test_silence_breaks_a_link_and_signs_of_life_keep_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_module, "LINK_SIGN_OF_LIFE_SECONDS", 0.01)
    monkeypatch.setattr(link_module, "BROKEN_AFTER_SECONDS", 0.2)
    wire = Wire(Notebook())
    await wire.greet()
    for _ in range(3):
        assert (await wire.sent.get()).update == pb.TimesUpdate()
    with pytest.raises(Unavailable, match="silent"):
        await wire.running


async def test_a_host_without_a_lease_reports_no_times_of_channels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_module, "LINK_SIGN_OF_LIFE_SECONDS", 0.01)
    notebook = Notebook()
    wire = Wire(notebook)
    await wire.greet()
    await notebook.stands.wait()
    notebook.has_lease = False
    with pytest.raises(HostNotFound):
        await wire.running
