"""Rules of access, for each verb and with both clients: a call is denied without a rule and succeeds with one.

When the rule is removed, open streams end. The core in memory knows no callers, so these tests run only over gRPC.
"""

from __future__ import annotations

import asyncio
import inspect
import itertools
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.contract.queues.rig import Rig
from tests.support.operator import Operator, operating
from tests.support.waiting import pause

numbers = itertools.count()
Do = Callable[["Scene"], Awaitable[Any]]


@pytest.fixture(scope="module")
def operator(cluster: LocalCluster) -> Iterator[Operator]:
    with operating(cluster) as standing, operating(cluster) as made:
        standing.add("nobody", "read", "no-test-uses-this/*")  # without any rule every caller may do everything
        yield made


@dataclass
class Scene:
    """A client to which rules apply (`rt`), one to which they do not (`own`), and the things that they use.

    `credentials_of`: returns the arguments of a connection for a caller of that name; "": for a caller without rules.
    """

    operator: Operator
    rig: Rig
    credentials_of: Callable[[str], dict[str, Any]]
    who: str = field(default_factory=lambda: f"contract-{next(numbers)}")
    own: Any = None
    rt: Any = None
    _other: Any = None

    async def connect(self, who: str = "", **named: Any) -> Any:
        return await self.rig.connect(**await asyncio.to_thread(self.credentials_of, who), **named)

    async def prepare(self) -> None:
        self.own, self.rt = await self.connect(), await self.connect(self.who)
        a, b = [await self.own.channel(self.name(thing), consumers=2) for thing in ("a", "b")]
        await self.own.group(self.name("pair"), [a, b])
        await self.own.queue(self.name("jobs"))
        await self.allow("list", "channel", "*")  # this verb gives no other right, but lets a client find the things

    def name(self, thing: str) -> str:
        return f"access/{self.who}/{thing}"

    async def allow(self, verb: str, kind: str, thing: str) -> None:
        await asyncio.to_thread(self.operator.add, self.who, verb, self.name(thing), "--kind", kind)

    async def forbid(self, verb: str, kind: str, thing: str) -> None:
        """Remove the rule that `allow` added."""
        await asyncio.to_thread(self.operator.rm, self.who, verb, self.name(thing), "--kind", kind)

    async def channel(self, thing: str = "a") -> Any:
        return await self.rt.channel(self.name(thing), create=False)

    async def queue(self) -> Any:
        return await self.rt.queue(self.name("jobs"), create=False)

    async def group(self) -> Any:
        return await self.rt.group(self.name("pair"))

    async def other_peer(self) -> Any:
        """Return a peer of another caller."""
        if self._other is None:
            self._other = await self.connect(name=self.name("other"))
        return self._other

    async def peer(self) -> Any:
        """Return another connection of the same caller, with the peer's name."""
        peer = await self.connect(self.who, name=self.name("peer"))
        await peer.mailbox.get(timeout=0)
        return peer


@asynccontextmanager
async def prepared(
    client: str, operator: Operator, credentials_of: Callable[[str], dict[str, Any]]
) -> AsyncIterator[Scene]:
    """Yield a scene for the `client` "aio" or "sync". At the end remove its rules.

    All parts of the cluster get all rules after each change. So rules of earlier tests would slow down the later ones.
    """
    with ThreadPoolExecutor(16) as pool:
        rig = Rig(operator.cluster.address, pool if client == "sync" else None)
        scene = Scene(operator, rig, credentials_of)
        await scene.prepare()
        yield scene
        for connection in rig.connections:
            await connection.aclose()
        await asyncio.to_thread(operator.take_back)


@pytest.fixture(params=["aio", "sync"])
async def scene(request: pytest.FixtureRequest, operator: Operator) -> AsyncIterator[Scene]:
    async with prepared(request.param, operator, lambda who: {"secret": operator.token(who)} if who else {}) as made:
        yield made


async def consume(scene: Scene) -> None:
    item = await (await scene.own.channel(scene.name("a"))).put(b"x")
    assert await (await scene.channel()).consume(item) == 1


async def take(scene: Scene) -> None:
    await (await scene.own.queue(scene.name("jobs"))).put(b"job")
    message = await (await scene.queue()).get(timeout=10)
    assert message.payload == b"job"
    await message.ack()


async def send(scene: Scene) -> None:
    other = await scene.other_peer()
    await scene.rt.send(scene.name("other"), b"x")
    assert (await other.mailbox.get(timeout=10)).payload == b"x"


async def create_group(scene: Scene) -> None:
    await scene.rt.group(scene.name("new"), [await scene.channel()])


async def add_member(scene: Scene) -> None:
    await scene.own.channel(scene.name("c"))
    await (await scene.group()).add(await scene.channel("c"))


CASES: dict[tuple[str, str, str], Do] = {
    ("read", "channel", "a"): lambda scene: then(scene.channel(), "newest"),
    ("read", "group", "pair"): lambda scene: then(scene.group(), "newest"),
    ("put", "channel", "a"): lambda scene: then(scene.channel(), "put", b"x"),
    ("consume", "channel", "a"): consume,
    ("advance", "channel", "a"): lambda scene: then(scene.channel(), "advance", 1),
    ("create", "channel", "new"): lambda scene: scene.rt.channel(scene.name("new")),
    ("create", "queue", "new"): lambda scene: scene.rt.queue(scene.name("new")),
    ("create", "group", "new"): create_group,
    ("configure", "channel", "a"): lambda scene: then(scene.channel(), "configure", max_items=9),
    ("configure", "queue", "jobs"): lambda scene: then(scene.queue(), "configure", lease="9s"),
    ("configure", "group", "pair"): add_member,
    ("delete", "channel", "a"): lambda scene: then(scene.channel(), "delete"),
    ("delete", "queue", "jobs"): lambda scene: then(scene.queue(), "delete"),
    ("delete", "group", "pair"): lambda scene: then(scene.group(), "delete"),
    ("take", "queue", "jobs"): take,
    ("send", "queue", "jobs"): lambda scene: then(scene.queue(), "put", b"job"),
    ("send", "peer", "other"): send,
    ("register", "peer", "peer"): lambda scene: scene.peer(),
}


async def then(handle: Awaitable[Any], method: str, *args: Any, **named: Any) -> Any:
    return await getattr(await handle, method)(*args, **named)


@pytest.mark.parametrize("case", CASES, ids=" ".join)
async def test_each_verb_is_denied_without_a_rule_and_succeeds_with_it(
    scene: Scene, case: tuple[str, str, str]
) -> None:
    verb, kind, thing = case
    name = scene.name(thing)
    if kind != "channel":
        await scene.allow("list", kind, "*")
    if kind == "group":
        await scene.allow("read", "channel", "*")
    with pytest.raises(st.PermissionDenied) as caught:
        await CASES[case](scene)
    assert caught.value.message.removeprefix(
        f"channel {scene.name('a')!r}: "
    ) == (  # the error of a read through a group begins with the channel
        f"client {scene.who} may not {verb} {kind} {name}; an operator can allow it "
        f"(stampede acl add {scene.who} {verb} {name} --kind {kind}), unless a rule denies it (stampede acl ls)"
    )
    assert caught.value.reason == "PERMISSION_DENIED"
    assert caught.value.metadata.items() >= {"verb": verb, kind: name}.items()
    await scene.allow(verb, kind, thing)
    await CASES[case](scene)


# -- open streams --------------------------------------------------------------------------------------------------


async def next_value(opening: Any) -> Awaitable[Any]:
    """Open a stream. Returns an awaitable of its next value."""
    stream = await opening if inspect.isawaitable(opening) else opening
    await stream.__aenter__()
    return asyncio.ensure_future(anext(aiter(stream)))


async def subscribing(scene: Scene) -> Awaitable[Any]:
    return await next_value((await scene.channel()).subscribe())


async def waiting_get(scene: Scene) -> Awaitable[Any]:
    channel, own = await scene.channel(), await scene.own.channel(scene.name("a"))
    waiting = asyncio.ensure_future(channel.newest(timeout=30))
    async with asyncio.timeout(45):
        while not (await own.stats()).waiting_gets:
            await pause()
    return waiting


async def putting(scene: Scene) -> Awaitable[Any]:
    channel = await scene.channel()
    await channel.put(b"x")

    async def put_forever() -> None:
        while True:
            await channel.put(b"x")

    return asyncio.ensure_future(put_forever())


async def taking(scene: Scene) -> Awaitable[Any]:
    queue, own = await scene.queue(), await scene.own.queue(scene.name("jobs"))
    waiting = asyncio.ensure_future(queue.get(timeout=30))
    async with asyncio.timeout(45):
        while not (await own.stats()).waiting_gets:
            await pause()
    return waiting


async def following_cuts(scene: Scene) -> Awaitable[Any]:
    return await next_value((await scene.group()).subscribe())


async def matching(scene: Scene) -> Awaitable[Any]:
    return await next_value((await scene.group()).match(await scene.channel(), tolerance="1s"))


STREAMS: dict[str, tuple[str, str, str, Callable[[Scene], Awaitable[Awaitable[Any]]]]] = {
    "subscription": ("read", "channel", "a", subscribing),
    "waiting get": ("read", "channel", "a", waiting_get),
    "puts": ("put", "channel", "a", putting),
    "taker": ("take", "queue", "jobs", taking),
    "cuts": ("read", "group", "pair", following_cuts),
    "matches": ("read", "group", "pair", matching),
}


@pytest.mark.parametrize("stream", STREAMS)
async def test_an_open_stream_ends_when_the_rule_that_allows_it_is_removed(scene: Scene, stream: str) -> None:
    verb, kind, thing, begin = STREAMS[stream]
    await scene.allow(verb, kind, thing)
    if kind == "group":
        await scene.allow("read", "channel", "*")
    waiting = await begin(scene)
    await scene.forbid(verb, kind, thing)
    refused = f"{scene.who} may (not {verb}|do nothing with( this)?) {kind}"
    with pytest.raises(st.PermissionDenied, match=refused):
        async with asyncio.timeout(45):
            await waiting


async def test_a_right_that_is_lost_for_one_channel_ends_the_waiting_get_of_that_channel_only(scene: Scene) -> None:
    """All gets of a client share one stream. In an earlier version, the lost right ended the whole stream."""
    for thing in ("a", "b"):
        await scene.allow("read", "channel", thing)
    await scene.allow("read", "group", "pair")
    lost, kept = await scene.channel("a"), await scene.channel("b")
    own = [await scene.own.channel(scene.name(thing)) for thing in ("a", "b")]
    through = (await scene.group())[scene.name("a")]
    waiting = [asyncio.ensure_future(one.newest(timeout=30)) for one in (lost, through, kept)]
    async with asyncio.timeout(20):
        while [(await one.stats()).waiting_gets for one in own] != [2, 1]:
            await pause()
        await scene.forbid("read", "channel", "a")
        for one in waiting[:2]:
            with pytest.raises(st.PermissionDenied, match=f"may (not read|do nothing with) channel {scene.name('a')}"):
                await one
        await own[1].put(b"x")
        assert (await waiting[2]).payload == b"x"
        assert (await kept.newest()).payload == b"x"


async def test_the_loss_of_the_right_to_a_group_ends_no_gets_of_its_channels(scene: Scene) -> None:
    await scene.allow("read", "channel", "*")
    for verb in ("read", "list"):  # with the right `list` the caller may see the name in the error
        await scene.allow(verb, "group", "pair")
    channel, own = await scene.channel("a"), await scene.own.channel(scene.name("a"))
    through = (await scene.group())[scene.name("a")]
    waiting = [asyncio.ensure_future(one.newest(timeout=30)) for one in (through, channel)]
    async with asyncio.timeout(20):
        while (await own.stats()).waiting_gets < 2:
            await pause()
        await scene.forbid("read", "group", "pair")
        with pytest.raises(st.PermissionDenied, match=f"may (not read|do nothing with) group {scene.name('pair')}"):
            await waiting[0]
        await own.put(b"x")
        assert (await waiting[1]).payload == b"x"


async def test_a_right_that_is_lost_for_one_channel_fails_the_puts_of_that_channel_only(scene: Scene) -> None:
    """All channels of a thread share one stream of puts. In an earlier version, a lost right ended the whole stream."""
    for thing in ("a", "b"):
        await scene.allow("put", "channel", thing)
    lost, kept = await scene.channel("a"), await scene.channel("b")
    is_running, done = True, 0

    async def put_until_stopped() -> None:
        nonlocal done
        while is_running:
            await kept.put(b"x")
            done += 1

    await lost.put(b"x")
    others = asyncio.ensure_future(put_until_stopped())
    await scene.forbid("put", "channel", "a")
    async with asyncio.timeout(20):
        with pytest.raises(st.PermissionDenied, match=f"may (not put|do nothing with) channel {scene.name('a')}"):
            await lost.put(b"x")
        is_running = False
        await others
    assert done


@pytest.mark.parametrize("kind", ["channel", "queue"])
async def test_a_put_that_waits_for_room_is_refused_when_its_caller_loses_the_right(scene: Scene, kind: str) -> None:
    opens, verb = ("channel", "put") if kind == "channel" else ("queue", "send")
    kept = {"max_age": "1h"} if kind == "channel" else {}
    own = await getattr(scene.own, opens)(scene.name("full"), max_items=1, on_full="block", **kept)
    await scene.allow(verb, kind, "full")
    await scene.allow("list", kind, "full")  # otherwise the error would not contain the name
    handle = await getattr(scene.rt, opens)(scene.name("full"), create=False)
    await handle.put(b"1")
    waiting = asyncio.ensure_future(handle.put(b"2", timeout=30))
    async with asyncio.timeout(20):
        while not (await own.stats()).waiting_puts:
            await pause()
        await scene.forbid(verb, kind, "full")
        with pytest.raises(st.PermissionDenied, match=f"may not {verb} {kind} {scene.name('full')}"):
            await waiting
        assert not (await own.stats()).waiting_puts


# -- list ----------------------------------------------------------------------------------------------------------


async def test_listings_hold_only_things_that_the_caller_may_list(scene: Scene) -> None:
    await scene.forbid("list", "channel", "*")
    await scene.other_peer()
    everything = {
        "channel": scene.rt.channels,
        "queue": scene.rt.queues,
        "group": scene.rt.groups,
        "peer": scene.rt.peers,
    }
    shown = {"channel": "b", "queue": "jobs", "group": "pair", "peer": "other"}
    for kind, listed in everything.items():
        assert await listed(scene.name("*")) == []
        await scene.allow("list", kind, shown[kind])
        assert [one.name for one in await listed(scene.name("*"))] == [scene.name(shown[kind])]


async def test_a_watch_reports_only_things_that_the_present_rules_let_the_caller_list(scene: Scene) -> None:
    await scene.forbid("list", "channel", "*")
    await scene.allow("list", "channel", "shown-*")
    opening = scene.rt.watch(scene.name("*"))
    watch = await opening if inspect.isawaitable(opening) else opening
    async with watch, asyncio.timeout(45):
        for thing in ("hidden-1", "shown-1"):
            await scene.own.channel(scene.name(thing))
        assert (await anext(watch)).subject.name == scene.name("shown-1")
        await scene.allow("list", "channel", "also-*")
        await scene.forbid("list", "channel", "shown-*")
        for thing in ("shown-2", "also-1"):
            await scene.own.channel(scene.name(thing))
        assert (await anext(watch)).subject.name == scene.name("also-1")


async def test_a_watch_of_peers_reports_only_peers_that_the_caller_may_list(scene: Scene) -> None:
    await scene.allow("list", "peer", "shown")
    opening = scene.rt.watch_peers(scene.name("*"))
    watch = await opening if inspect.isawaitable(opening) else opening
    async with watch, asyncio.timeout(45):
        for thing in ("hidden", "shown"):
            peer = await scene.connect(name=scene.name(thing))
            await peer.mailbox.get(timeout=0)
        assert (await anext(watch)).peer.name == scene.name("shown")
