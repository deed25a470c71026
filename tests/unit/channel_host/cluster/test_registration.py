"""A host enters the directory, stays in it, and stops in time when it cannot."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from stampede_rt.errors import HostExists, LeaseExpired, NotLeader, PermissionDenied, Unavailable, VersionMismatch
from stampede_rt.status import abort
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1.directory_service_pb2 import RegisterHostResponse, RenewHostLeaseResponse
from stampede_rt_channel_host.cluster.identity import (
    HomeCluster,
    HostIdentity,
)
from stampede_rt_channel_host.cluster.registration import Registration
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_runtime.clock import SystemClock
from stampede_rt_runtime.dial import dial, naming_cluster
from stampede_rt_runtime.server import serving
from tests.support.channel_host.fake_directory import FakeDirectory

MS = 10**6


class Host:
    """A registration under test, and the events that it reported."""

    def __init__(self, frontend: str, name: str = "h1", folder: Path | None = None, boot: int = 7) -> None:
        self.identity = HostIdentity(host_id=name.encode().ljust(16, b"."), name=name, boot_incarnation=boot)
        self.home = HomeCluster(folder)
        dial_home = naming_cluster(lambda target: dial(target, secret=None), lambda: self.home.cluster_id)
        self.supernodes = Supernodes([frontend], dial_home, peer_name=name)
        self.registered: asyncio.Queue[Any] = asyncio.Queue()
        self.lease: asyncio.Queue[bool] = asyncio.Queue()
        self.registration = Registration(
            self.identity,
            self.supernodes,
            SystemClock(),
            on_registered=self.registered.put,
            on_lease=self.lease.put_nowait,
            home=self.home,
        )

    async def lease_becomes(self, held: bool) -> None:
        async with asyncio.timeout(30):
            while await self.lease.get() is not held:
                pass


@asynccontextmanager
async def directory(**options: Any) -> AsyncIterator[FakeDirectory]:
    fake = FakeDirectory(**options)
    async with serving(fake.register) as server:
        fake.target = server.address
        yield fake


@asynccontextmanager
async def keeping(host: Host) -> AsyncIterator[None]:
    task = asyncio.create_task(host.registration.keep())
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await host.supernodes.aclose()


async def test_a_host_registers_and_holds_its_lease() -> None:
    async with directory() as fake:
        host = Host(fake.target)
        assert not host.registration.lease_held()
        await host.registration.enter("localhost:1")
        assert host.registration.lease_held()
        assert fake.hosts[host.identity.host_id].gatekeepers[0].target == "localhost:1"
        assert host.registered.qsize() == 1
        await host.supernodes.aclose()


async def test_a_host_names_the_cluster_of_its_first_registration_after_a_restart(tmp_path: Path) -> None:
    async with directory(lease_ttl_nanos=200 * MS) as fake:
        first = Host(fake.target, folder=tmp_path)
        await first.registration.enter("localhost:1")
        async with keeping(first):
            await fake.called("RenewHostLease", times=1)
        restarted = Host(fake.target, folder=tmp_path)
        await restarted.registration.enter("localhost:1")
        await restarted.supernodes.aclose()
    assert fake.named_clusters == {"RegisterHost": ["", "c"], "RenewHostLease": ["c"] * fake.calls["RenewHostLease"]}


async def test_a_host_whose_lease_the_successor_cluster_renews_belongs_to_that_cluster(
    tmp_path: Path,
) -> None:
    """The host serves the callers of both clusters from then on, because each caller changes over at a moment of its
    own.
    """
    async with directory(lease_ttl_nanos=200 * MS) as fake:
        host = Host(fake.target, folder=tmp_path)
        await host.registration.enter("localhost:1")
        async with keeping(host):
            await fake.called("RenewHostLease", times=1)
            assert host.home.judge("d") is not None
            fake.cluster_id, fake.former_cluster_ids = "d", ["c"]
            await fake.called("RenewHostLease", times=fake.calls["RenewHostLease"] + 3)
            assert (host.home.judge("c"), host.home.judge("d")) == (None, None)
    assert HomeCluster(tmp_path).cluster_id == "d"
    assert set(fake.named_clusters["RenewHostLease"]) == {"c", "d"}


async def test_a_host_renews_three_times_per_ttl_and_is_not_fenced() -> None:
    async with directory(lease_ttl_nanos=2000 * MS) as fake:  # a busy machine may halt this process for a second
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        async with keeping(host):
            await fake.called("RenewHostLease", times=4)
            assert host.registration.lease_held()
            assert [host.lease.get_nowait()] == [True]
            assert host.lease.empty()


async def test_a_host_whose_renewals_fail_is_fenced_and_serves_again_after_the_next_one() -> None:
    async with directory(lease_ttl_nanos=200 * MS) as fake:
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        async with keeping(host):
            await host.lease_becomes(True)  # on a busy machine the first grant may come too late
            fake.refuse["RenewHostLease"] = Unavailable("no majority")
            await host.lease_becomes(False)
            assert not host.registration.lease_held()
            fake.refuse.clear()
            await host.lease_becomes(True)
            assert host.registered.qsize() == 1  # the answer was only late: there is no second registration


class SlowDirectory:
    """Answers registration and the first renewal, both 3 s after they were sent, and nothing else."""

    def __init__(self) -> None:
        self.now = 100 * 10**9
        self.methods: list[str] = []

    def boottime_nanos(self) -> int:
        return self.now

    def time_unix_nano(self) -> int:
        return self.now

    async def call(self, method: str, request: object, timeout_s: float) -> object:
        self.methods.append(method)
        if len(self.methods) > 2:
            await asyncio.Event().wait()
        self.now += 3 * 10**9
        if method == "RegisterHost":
            return RegisterHostResponse(lease_ttl_nanos=5 * 10**9)
        return RenewHostLeaseResponse(lease_ttl_nanos=5 * 10**9)


async def test_a_lease_begins_when_the_host_sends_the_request() -> None:
    slow = SlowDirectory()

    async def ignore(_: object) -> None:
        pass

    registration = Registration(
        HostIdentity(host_id=b"h" * 16, name="h1", boot_incarnation=7),
        slow,  # type: ignore[arg-type]  # only `call` is used here
        slow,  # type: ignore[arg-type]  # and of the clock this
        on_registered=ignore,
        on_lease=lambda held: None,
    )
    await registration.enter("localhost:1")
    start = 100 * 10**9
    for seconds, held in ((3.9, True), (4.1, False)):
        slow.now = start + int(seconds * 10**9)
        assert registration.lease_held() is held
    slow.now = start + 3 * 10**9
    keeping_on = asyncio.create_task(registration.keep())
    while len(slow.methods) < 3:  # noqa: ASYNC110 - nothing announces it
        await asyncio.sleep(0)
    keeping_on.cancel()
    for seconds, held in ((6.9, True), (7.1, False)):
        slow.now = start + int(seconds * 10**9)
        assert registration.lease_held() is held


async def test_the_loss_of_renewals_and_their_return_are_logged_once_each(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    async with directory(lease_ttl_nanos=200 * MS) as fake:
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        async with keeping(host):
            await host.lease_becomes(True)  # on a busy machine the first grant may come too late
            fake.refuse["RenewHostLease"] = Unavailable("no majority")
            await host.lease_becomes(False)
            await fake.called("RenewHostLease", times=5)
            fake.refuse.clear()
            await host.lease_becomes(True)
            await fake.called("RenewHostLease", times=8)
    messages = [record.getMessage().partition(";")[0] for record in caplog.records if "lease" in record.getMessage()]
    lines = [line for line in messages if "fenced" not in line]
    assert lines[:2] == ["the lease could not be renewed", "the lease is renewed again"]
    # A busy machine may be late for one more renewal, which has the same line.
    assert all(line != after for line, after in itertools.pairwise(lines))


async def test_a_host_whose_lease_has_ended_registers_again_as_the_same_start_of_the_process() -> None:
    async with directory(lease_ttl_nanos=200 * MS) as fake:
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        record = fake.add_channel("a", host.identity.host_id)
        async with keeping(host):
            fake.hosts[host.identity.host_id].alive = False
            await host.registered.get()
            async with asyncio.timeout(30):
                answer = await host.registered.get()
            assert [one.channel_id for one in answer.channels] == [record.channel_id]
            assert answer.channels[0].epoch == 1
            await host.lease_becomes(True)


class LosingDirectory(FakeDirectory):
    """Registers hosts. While `loses` is set, the answers are lost."""

    loses = False

    async def RegisterHost(self, request: pb.RegisterHostRequest, context: Any) -> pb.RegisterHostResponse:  # noqa: N802
        response = await super().RegisterHost(request, context)
        if self.loses:
            await abort(context, PermissionDenied("the answer is lost"))
        return response


async def test_a_host_whose_lease_has_ended_serves_nothing_before_an_answer_names_its_channels() -> None:
    """The directory registered the host, and the answer was lost. In an earlier version the next renewal succeeded, and
    the host served the channels that other hosts had taken over.
    """
    fake = LosingDirectory()
    async with serving(fake.register) as server:
        fake.target = server.address
        host = Host(server.address)
        await host.registration.enter("localhost:1")
        fake.hosts[host.identity.host_id].alive, fake.loses = False, True
        for _ in range(2):
            with pytest.raises(PermissionDenied):
                await host.registration._renew_or_register()
            assert fake.hosts[host.identity.host_id].alive
            assert not host.registration.lease_held()
        fake.loses = False
        await host.registration._renew_or_register()
        assert host.registration.lease_held()
        assert host.registered.qsize() == 2
        await host.supernodes.aclose()


async def test_the_end_of_a_lease_and_the_next_registration_are_both_warnings(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("WARNING", logger="stampede_rt_channel_host")
    async with directory(lease_ttl_nanos=200 * MS) as fake:
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        async with keeping(host):
            fake.hosts[host.identity.host_id].alive = False
            await fake.called("RegisterHost", times=2)
            await fake.called("RenewHostLease", times=2)
    messages = [record.getMessage() for record in caplog.records]
    assert [line for line in messages if line in ("the lease has ended", "registered", "registered again")] == [
        "the lease has ended",
        "registered again",
    ]


async def test_a_host_waits_for_a_name_that_its_former_process_still_holds() -> None:
    async with directory() as fake:
        fake.refuse["RegisterHost"] = HostExists("another live host has the name h1")
        host = Host(fake.target)
        entering = asyncio.create_task(host.registration.enter("localhost:1"))
        await fake.called("RegisterHost", times=2)
        fake.refuse.clear()
        await entering
        assert host.registration.lease_held()
        await host.supernodes.aclose()


async def test_a_restarted_host_replaces_its_former_process_with_the_next_registration_epoch() -> None:
    async with directory() as fake:
        for boot in (7, 8, 9):
            host = Host(fake.target, boot=boot)
            await host.registration.enter("localhost:1")
            assert fake.hosts[host.identity.host_id].boot_incarnation == boot
            await host.supernodes.aclose()
        assert fake.hosts[host.identity.host_id].registration_epoch == 2


async def test_an_older_process_of_a_host_does_not_register_again_while_the_newer_one_lives() -> None:
    """In an earlier version, the two processes took the channels from each other again and again."""
    async with directory(lease_ttl_nanos=200 * MS) as fake:
        former, newer = Host(fake.target), Host(fake.target, boot=8)
        await former.registration.enter("localhost:1")
        await newer.registration.enter("localhost:1")
        tried = fake.calls["RegisterHost"]
        async with keeping(former):
            await fake.called("RegisterHost", times=tried + 2)
            own = fake.hosts[newer.identity.host_id]
            assert (own.boot_incarnation, own.registration_epoch) == (8, 1)
            assert not former.registration.lease_held()
            while not former.lease.empty():
                former.lease.get_nowait()
            own.alive = False
            await former.lease_becomes(True)
        assert fake.hosts[former.identity.host_id].registration_epoch == 2
        await newer.supernodes.aclose()


async def test_a_permanent_error_ends_the_start_immediately() -> None:
    async with directory() as fake:
        fake.refuse["RegisterHost"] = PermissionDenied("not this one")
        host = Host(fake.target)
        with pytest.raises(PermissionDenied, match="not this one"):
            await host.registration.enter("localhost:1")
        assert fake.calls["RegisterHost"] == 1
        await host.supernodes.aclose()


async def test_a_start_without_any_front_end_ends_with_a_reason() -> None:
    host = Host("localhost:1")
    with pytest.raises(Unavailable, match="cannot learn the supernodes from localhost:1"):
        await host.registration.enter("localhost:1", timeout_s=0.1)
    await host.supernodes.aclose()


async def test_a_host_asks_the_leader_that_a_follower_has_named() -> None:
    async with directory() as follower, directory() as leader:
        follower.refuse["RegisterHost"] = NotLeader("not me", metadata={"leader_endpoint": leader.target})
        host = Host(follower.target)
        await host.registration.enter("localhost:1")
        assert leader.hosts.keys() == {host.identity.host_id}
        await host.supernodes.aclose()


async def test_a_host_skips_a_dead_supernode() -> None:
    async with directory() as fake:
        fake.others = ["localhost:1"]
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        assert host.registration.lease_held()
        await host.supernodes.aclose()


async def test_a_host_that_leaves_deregisters_and_ends_its_lease() -> None:
    async with directory() as fake:
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        await host.registration.leave()
        assert not host.registration.lease_held()
        assert not fake.hosts[host.identity.host_id].alive
        await host.supernodes.aclose()


async def test_an_ended_lease_is_reported_to_the_fence_before_registering_again() -> None:
    async with directory() as fake:
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        fake.refuse["RenewHostLease"] = LeaseExpired("ended")
        fake.refuse["RegisterHost"] = HostExists("another has the name now")
        with pytest.raises(HostExists):
            async with asyncio.timeout(30):
                await host.registration._renew_or_register()
        await host.lease_becomes(False)
        assert not host.registration.lease_held()
        await host.supernodes.aclose()


class NewerDirectory(FakeDirectory):
    """Answers registrations in a later protocol."""

    async def RegisterHost(self, request: pb.RegisterHostRequest, context: Any) -> pb.RegisterHostResponse:  # noqa: N802
        assert request.protocol_version == 1
        response = await super().RegisterHost(request, context)
        response.protocol_version = 2
        return response


async def test_a_host_does_not_register_at_a_directory_of_another_protocol() -> None:
    fake = NewerDirectory()
    async with serving(fake.register) as server:
        fake.target = server.address
        host = Host(server.address)
        with pytest.raises(VersionMismatch, match="the directory speaks protocol 2, this host 1"):
            await host.registration.enter("localhost:1", 5)
        assert not host.registration.lease_held()
        await host.supernodes.aclose()
