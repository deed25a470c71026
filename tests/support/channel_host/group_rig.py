"""Channel hosts that share groups, behind real gRPC, with a directory in memory that knows groups, too."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import grpc

from stampede_rt.errors import error_for
from stampede_rt.status import abort
from stampede_rt.v1 import (
    channel_pb2,
    channel_service_pb2,
    directory_pb2,
    directory_service_pb2,
    group_directory_service_pb2,
    group_directory_service_pb2_grpc,
    group_pb2,
    item_pb2,
)
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt.v1.group_service_pb2_grpc import GroupServiceStub
from stampede_rt_channel_host.host import ChannelHost
from stampede_rt_runtime.clock import HostClock, SystemClock
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.server import ServiceServer, serving
from tests.support.channel_host.fake_directory import FakeDirectory
from tests.support.channel_host.in_process_host import started_host
from tests.support.channel_host.rig import MAX_INSTANT, MIN_INSTANT, S, between, payloads_of, run_of

WAIT_SECONDS = 45.0


class GroupDirectory(FakeDirectory, group_directory_service_pb2_grpc.GroupDirectoryServiceServicer):
    """A directory in memory with groups, which tests change by hand."""

    def __init__(self) -> None:
        super().__init__(lease_ttl_nanos=600 * S)
        self.groups: dict[bytes, group_pb2.GroupRecord] = {}
        self._watchers: set[asyncio.Queue[directory_pb2.DirectoryChange]] = set()

    def register(self, server: grpc.aio.Server) -> None:
        super().register(server)
        group_directory_service_pb2_grpc.add_GroupDirectoryServiceServicer_to_server(self, server)

    def add_group(self, name: str, channels: Sequence[GroupedChannel], **spec: Any) -> group_pb2.GroupRecord:
        record = group_pb2.GroupRecord(
            group_id=secrets.token_bytes(16),
            name=name,
            spec=group_pb2.GroupSpec(channel_ids=[one.channel_id for one in channels], **spec),
            spec_version=1,
            incarnation=secrets.randbits(63) | 1,
        )
        self.groups[record.group_id] = record
        return record

    def change_members(self, group_id: bytes, channels: Sequence[GroupedChannel], *, reported: bool = True) -> None:
        """Give the group these members. With `reported`, report the change to watchers."""
        record = self.groups[group_id]
        record.spec.channel_ids[:] = [one.channel_id for one in channels]
        record.spec_version += 1
        if reported:
            self._report(directory_pb2.DirectoryChange(kind=directory_pb2.CHANGE_KIND_UPDATED, group=record))

    def delete_group(self, group_id: bytes) -> None:
        """Delete the group, and report this to watchers."""
        record = self.groups.pop(group_id)
        self._report(directory_pb2.DirectoryChange(kind=directory_pb2.CHANGE_KIND_REMOVED, group=record))

    def give_to(self, channel_id: bytes, host_id: bytes) -> channel_pb2.ChannelRecord:
        """Give the channel to another host, without its items, as after the loss of its host.

        Report this to watchers.
        """
        record = self.channels[channel_id]
        record.host_id, record.epoch, record.incarnation = host_id, record.epoch + 1, record.incarnation + 1
        self._report(directory_pb2.DirectoryChange(kind=directory_pb2.CHANGE_KIND_UPDATED, channel=record))
        return record

    def _report(self, change: directory_pb2.DirectoryChange) -> None:
        for watcher in self._watchers:
            watcher.put_nowait(change)

    async def Watch(  # noqa: N802
        self, request: Any, context: Any
    ) -> AsyncIterator[directory_service_pb2.WatchResponse]:
        assert request.include_groups or request.include_queues or request.include_access
        changes: asyncio.Queue[directory_pb2.DirectoryChange] = asyncio.Queue()
        self._watchers.add(changes)
        await self._begin("Watch", context)
        yield directory_service_pb2.WatchResponse(applied_index=1)
        while True:
            yield directory_service_pb2.WatchResponse(changes=[await changes.get()])

    async def ResolveGroup(self, request: Any, context: Any) -> Any:  # noqa: N802
        await self._begin("ResolveGroup", context)
        record = self.groups.get(request.group_id)
        if record is None:
            await abort(context, error_for("GROUP_NOT_FOUND", "there is no such group"))
        assert record is not None
        channels = [self.channels[one] for one in record.spec.channel_ids if one in self.channels]
        hosts = [self.hosts[one] for one in dict.fromkeys(one.host_id for one in channels) if one in self.hosts]
        return group_directory_service_pb2.ResolveGroupResponse(group=record, channels=channels, hosts=hosts)

    async def ListGroups(self, request: Any, context: Any) -> Any:  # noqa: N802
        await self._begin("ListGroups", context)
        found = [one for one in self.groups.values() if request.channel_id in one.spec.channel_ids]
        return group_directory_service_pb2.ListGroupsResponse(groups=found)


class Host:
    """One host of a cluster, and the generated stubs."""

    def __init__(self, directory: GroupDirectory, host: ChannelHost, server: ServiceServer) -> None:
        self.directory = directory
        self.host = host
        self.server = server
        self.target = server.address
        self.accounts = server.access.accounts
        options = [*Limits().channel_options(), ("grpc.http2.bdp_probe", 0)]
        self.connection = grpc.aio.insecure_channel(self.target, options=options)
        self.channels = ChannelServiceStub(self.connection)
        self.groups = GroupServiceStub(self.connection)
        self.gate = GatekeeperServiceStub(self.connection)
        self.stopped = False

    def now(self) -> int:
        return self.host.store.now()

    async def open(self, name: str, spec: channel_pb2.ChannelSpec | None = None) -> GroupedChannel:
        record = self.directory.add_channel(name, self.host.identity.host_id, spec)
        return await self.bound(record)

    async def bound(self, record: channel_pb2.ChannelRecord) -> GroupedChannel:
        await self.gate.BindChannel(gate_pb.BindChannelRequest(channel_id=record.channel_id, epoch=record.epoch))
        return GroupedChannel(self, record)

    async def status(self, group: group_pb2.GroupRecord) -> group_pb2.GroupStatus:
        request = pb.GetGroupStatusRequest(group_id=group.group_id)
        return (await self.groups.GetGroupStatus(request, timeout=WAIT_SECONDS)).status

    async def until(
        self, group: group_pb2.GroupRecord, condition: Callable[[group_pb2.GroupStatus], bool]
    ) -> group_pb2.GroupStatus:
        """Ask for the group's status again and again, until `condition` holds."""
        async with asyncio.timeout(WAIT_SECONDS):
            while not condition(status := await self.status(group)):
                pass
        return status

    async def until_cut(self, group: group_pb2.GroupRecord, cut: int) -> group_pb2.GroupStatus:
        return await self.until(group, lambda status: status.HasField("cut_unix_nano") and status.cut_unix_nano >= cut)

    async def stop(self) -> None:
        if not self.stopped:
            self.stopped = True
            await self.connection.close(None)
            await self.server.stop(self.host.leave)


class GroupedChannel:
    """A bound channel."""

    def __init__(self, host: Host, record: channel_pb2.ChannelRecord) -> None:
        self.host = host
        self.record = record
        self.channel_id = record.channel_id

    async def put(self, *times: int, durations: Sequence[int] | None = None) -> None:
        """Put an item at each time, with the time as its payload."""
        payloads = [str(time).encode() for time in times]
        request = channel_service_pb2.PutRequest(
            channel_id=self.channel_id,
            epoch=self.record.epoch,
            puts=[run_of(*payloads, times=times, durations=durations)],
        )
        acks = [ack async for response in self.host.channels.Put(iter((request,))) for ack in response.acks]
        assert [(ack.HasField("first_seq"), len(ack.rejections)) for ack in acks] == [(True, 0)]

    async def advance(self, instant: int) -> None:
        await self.host.channels.Advance(
            channel_service_pb2.AdvanceRequest(
                channel_id=self.channel_id, epoch=self.record.epoch, time_unix_nano=instant
            )
        )

    async def get(self, group: group_pb2.GroupRecord | None = None, **fields: Any) -> tuple[list[int], Any]:
        """Return the times of the items, and the summary."""
        if group is not None:
            fields["group_id"] = group.group_id
        fields.setdefault("interval", between(MIN_INSTANT, MAX_INSTANT))
        request = channel_service_pb2.GetRequest(
            call_id=1, channel_id=self.channel_id, epoch=self.record.epoch, **fields
        )
        async with asyncio.timeout(WAIT_SECONDS):
            responses = [one async for one in self.host.channels.Get(iter((request,)))]
        last = responses[-1]
        assert not last.HasField("error"), last.error
        times = [time for one in responses for run in one.runs for time in run.run.time_unix_nano]
        return times, last.summary

    def subscribe(self, group: group_pb2.GroupRecord, **fields: Any) -> GroupSubscriber:
        opening = channel_service_pb2.SubscribeOpen(
            channel_id=self.channel_id, epoch=self.record.epoch, group_id=group.group_id, **fields
        )
        request = channel_service_pb2.SubscribeRequest(open=opening, credit_bytes=2**40)
        return GroupSubscriber(self.host.channels.Subscribe(iter((request,))))


class GroupSubscriber:
    """One subscription through a group."""

    def __init__(self, call: Any) -> None:
        self.call = call

    async def opened(self) -> GroupSubscriber:
        async with asyncio.timeout(WAIT_SECONDS):
            assert (await self.call.read()).HasField("opened")
        return self

    async def take(self, count: int) -> list[int]:
        """Return the times of the next `count` items."""
        times: list[int] = []
        async with asyncio.timeout(WAIT_SECONDS):
            while len(times) < count:
                response = await self.call.read()
                times += [time for one in response.runs for time in one.run.time_unix_nano]
        return times


class CutReader:
    """One stream of cut events."""

    def __init__(self, host: Host, group: group_pb2.GroupRecord, **fields: Any) -> None:
        self.call = host.groups.SubscribeCuts()
        credit = fields.pop("credit", 1000 if fields.get("decides") else 0)
        opening = pb.SubscribeCutsOpen(group_id=group.group_id, **fields)
        self._open = pb.SubscribeCutsRequest(open=opening, credit=credit)

    async def opened(self) -> pb.CutCursor:
        await self.call.write(self._open)
        async with asyncio.timeout(WAIT_SECONDS):
            response = await self.call.read()
        assert response.HasField("opened"), response
        return response.opened

    async def send_boundary(self, boundary: pb.CutBoundary) -> None:
        await self.call.write(pb.SubscribeCutsRequest(boundary=boundary))

    async def event(self) -> Event:
        """Return the next whole event."""
        parts: list[pb.CutPart] = []
        async with asyncio.timeout(WAIT_SECONDS):
            while True:
                response = await self.call.read()
                parts += response.parts
                if response.HasField("boundary"):
                    return Event(response.boundary, parts)


class Event:
    """One host's part of an event."""

    def __init__(self, boundary: pb.CutBoundary, parts: Sequence[pb.CutPart]) -> None:
        self.boundary = boundary
        self.parts = parts

    def times(self, channel: GroupedChannel) -> list[int]:
        return _times(run for part in self.parts if part.channel_id == channel.channel_id for run in part.runs)

    def late(self, channel: GroupedChannel) -> list[int]:
        return _times(run for part in self.parts if part.channel_id == channel.channel_id for run in part.late_runs)

    def cursor(self, group: group_pb2.GroupRecord) -> pb.CutCursor:
        return pb.CutCursor(
            incarnation=group.incarnation,
            cut_unix_nano=self.boundary.cut_unix_nano,
            channels=[part.cursor for part in self.parts if part.HasField("cursor")],
        )


def _times(runs: Any) -> list[int]:
    found = []
    for delivered in runs:
        run: item_pb2.ItemRun = delivered.run
        assert payloads_of(run) == [str(time).encode() for time in run.time_unix_nano]
        found += list(run.time_unix_nano)
    return found


class Cluster:
    """A directory and hosts. `start` adds a host."""

    def __init__(self, directory: GroupDirectory, clock: HostClock) -> None:
        self.directory = directory
        self.clock = clock
        self.hosts: list[Host] = []

    async def start(self, name: str, host_id: bytes, *, boot: int = 7, listen: str = "localhost:0") -> Host:
        """Start a host, and return it when it has registered. The same id with another boot is a restarted host."""
        started = await started_host(
            self.directory.target, host_id=host_id, name=name, boot=boot, clock=self.clock, listen=listen
        )
        made = Host(self.directory, started.host, started.server)
        self.hosts.append(made)
        return made


@asynccontextmanager
async def running_cluster(clock: HostClock | None = None) -> AsyncIterator[Cluster]:
    """Yield a cluster without hosts. At the end all started hosts leave."""
    directory = GroupDirectory()
    async with AsyncExitStack() as stack:
        supernode = await stack.enter_async_context(serving(directory.register))
        directory.target = supernode.address
        cluster = Cluster(directory, clock or SystemClock())
        try:
            yield cluster
        finally:
            for host in reversed(cluster.hosts):
                await host.stop()
