"""When the credential of a caller ends, the host ends all socket streams of the caller, in whatever state they are.

When a caller loses the right to read, the host ends its subscriptions, and refuses its waiting gets.
"""

from __future__ import annotations

import asyncio
import select
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import grpc
import pytest

import stampede_rt as st
from stampede_rt.cli.commands import run
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import time_pb2
from stampede_rt.wire.stream_frames import FrameKind, frame_of, head_of
from stampede_rt_local.cluster import LocalCluster
from tests.robustness.fuzz.ports.socket_calls import socket_target
from tests.support.cluster import cluster_fixture
from tests.support.operator import Operator, operating
from tests.support.raw_stream import RawStream, raw_stream

pytestmark = pytest.mark.without_rules("it acts as an operator")
cluster = cluster_fixture(hosts=1, supernodes=1, durable=False)
NAME = "sockets/video"
ITEMS, ITEM_BYTES = 20, 100_000
SECONDS_MAX = 20
HOUR_NANOS = 3600 * 10**9
GONE = select.POLLRDHUP | select.POLLHUP
ALL = {"has sent nothing", "half of a frame", "a get that waits", "idle", "reads nothing", "has ended its side"}
SUBSCRIPTIONS = {"idle", "reads nothing"}


@pytest.fixture
def operator(cluster: LocalCluster) -> Iterator[Operator]:
    with operating(cluster) as made:
        yield made


@asynccontextmanager
async def streams(cluster: LocalCluster, token: str) -> AsyncIterator[dict[str, RawStream]]:
    """Streams of a caller with `token`. Each stream is in a different state, and the host serves all of them."""
    secret = cluster.secret.text
    with st.connect(cluster.address, secret=secret) as rt:
        channel = rt.channel(NAME, max_items=ITEMS)
        for _ in range(ITEMS):
            channel.put(bytes(ITEM_BYTES))
        known = {"channel_id": channel.info.channel_id, "epoch": channel.info.epoch}
    async with AsyncExitStack() as stack, grpc.aio.insecure_channel(cluster.hosts[0].address) as host:
        target = await socket_target(host, (("authorization", f"Bearer {secret}"),))

        async def begun(method: str, sent: bytes = b"") -> RawStream:
            made = await stack.enter_async_context(raw_stream(target))
            await made.begin(f"/stampede_rt.v1.ChannelService/{method}", secret=token)
            await made.send_bytes(sent)
            return made

        opened = pb.SubscribeOpen(**known, mode=pb.SUBSCRIBE_MODE_ALL)
        start = time_pb2.Bound(instant_unix_nano=time.time_ns() + HOUR_NANOS)
        later = time_pb2.Interval(start=start, end=time_pb2.Bound(instant_unix_nano=2**63 - 1))
        waiting = _frame(pb.GetRequest(**known, interval=later, wait_nanos=-1))
        found = {
            "has sent nothing": await begun("Put"),
            "half of a frame": await begun("Put", head_of(FrameKind.MESSAGE, 1000) + b"x"),
            "a get that waits": await begun("Get", waiting),
            "idle": await begun("Subscribe", _frame(pb.SubscribeRequest(open=opened))),
            "reads nothing": await begun("Subscribe", _frame(pb.SubscribeRequest(open=opened, credit_bytes=2**40))),
            "has ended its side": await begun("Get", waiting + frame_of(FrameKind.END)),
        }
        assert found.keys() == ALL
        yield found


def _frame(message: pb.GetRequest | pb.SubscribeRequest) -> bytes:
    return frame_of(FrameKind.MESSAGE, message.SerializeToString())


async def ended(found: dict[str, RawStream], names: set[str]) -> None:
    """Wait until the host has closed these streams, without reading from them."""
    poll, numbers = select.poll(), {}
    for name in names:
        number = found[name].writer.get_extra_info("socket").fileno()
        numbers[number] = name
        poll.register(number, GONE)
    async with asyncio.timeout(SECONDS_MAX):
        while numbers:
            for number, _ in await asyncio.to_thread(poll.poll, 50):
                poll.unregister(number)
                del numbers[number]


async def status_text(stream: RawStream) -> str:
    """The text of the status that the host has sent."""
    return str((await stream.status()).message)


async def all_admitted(operator: Operator, who: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Wait until the host counts all streams of the caller."""
    async with asyncio.timeout(SECONDS_MAX):
        while True:
            capsys.readouterr()
            assert await asyncio.to_thread(operator.run, "quota", "use", who) == 0
            if any("streams" in line and f" {len(ALL)} " in line for line in capsys.readouterr().out.splitlines()):
                return


async def test_a_revoked_token_ends_all_streams_of_its_caller(
    cluster: LocalCluster, operator: Operator, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    token, file = operator.token("revoked"), tmp_path / "revoked.token"
    file.write_text(token)
    async with streams(cluster, token) as found:
        await all_admitted(operator, "revoked", capsys)
        assert await asyncio.to_thread(run, ["token", "revoke", str(file), "--url", cluster.address]) == 0
        await ended(found, ALL)
        for name in ALL - {"reads nothing"}:  # to the caller that reads nothing the host cannot write
            assert "revoked" in await status_text(found[name]), name


async def test_an_expired_token_ends_all_streams_of_its_caller(cluster: LocalCluster, operator: Operator) -> None:
    async with streams(cluster, operator.new_token("brief", 3 * 10**9)) as found:
        await ended(found, ALL)
        for name in ALL - {"reads nothing"}:
            assert "the token of client brief has ended" in await status_text(found[name]), name


async def test_subscriptions_end_and_waiting_gets_are_refused_when_the_right_is_lost(
    cluster: LocalCluster, operator: Operator, capsys: pytest.CaptureFixture[str]
) -> None:
    operator.add("reader", "read,put", "sockets/*")
    async with streams(cluster, operator.token("reader")) as found:
        await all_admitted(operator, "reader", capsys)
        await asyncio.to_thread(operator.add, "reader", "read", NAME, "--deny")
        await ended(found, SUBSCRIPTIONS)
        for name in SUBSCRIPTIONS - {"reads nothing"}:
            assert f"may not read channel {NAME}" in await status_text(found[name]), name
        for name in ("a get that waits", "has ended its side"):
            refused = pb.GetResponse.FromString(await found[name].message())
            assert f"may not read channel {NAME}" in refused.error.message
