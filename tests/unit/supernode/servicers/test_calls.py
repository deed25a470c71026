"""The checks of a supernode before an update: for a thing that the supernode does not know yet, and for mailboxes."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import grpc
import pytest

from stampede_rt.errors import PermissionDenied
from stampede_rt.v1.group_directory_service_pb2 import UpdateGroupRequest
from stampede_rt_runtime.access.caller import Caller, CallerKind
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.access.rules import AccessKind, AccessRule, AccessRules, AccessVerb
from stampede_rt_runtime.access.state import AccessState
from stampede_rt_runtime.identity import Role
from stampede_rt_supernode.core.cluster.commands import RaiseFeatureLevel
from stampede_rt_supernode.core.cluster.feature_levels import OWNERS_LEVEL
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.group_servicer import GroupDirectoryServicer
from tests.support.supernode.operations import Log, id_of, open_channel, open_queue, register, register_peer

CONTEXT: Any = SimpleNamespace(time_remaining=lambda: 5.0, peer=lambda: "here")
ALL = AccessRule("*", (), None, "*")


class ReplicaBehind:
    """A replica and its log. Everything but the first entries comes only with a confirmed read."""

    def __init__(self, known: Directory, committed: Directory) -> None:
        self._state, self._committed = known, committed
        self.confirmed = 0

    def read(self, query: Callable[[Directory], Any]) -> Any:
        return query(self._state)

    async def confirm(self, *, seconds: float) -> int:
        self._state = self._committed
        self.confirmed += 1
        return 1

    def check_state(self) -> None:
        """Accept the state."""


@pytest.fixture
def log() -> Log:
    log = Log()
    log.apply(RaiseFeatureLevel(feature_level=OWNERS_LEVEL))
    log.apply(register(1, name="one"))
    log.apply(open_channel("secret/plan"))
    log.apply(open_queue("jobs"))
    log.apply(replace(register_peer(7, name="robot"), owner="robot"))
    return log


@asynccontextmanager
async def called_by(name: str, *rules: AccessRule) -> AsyncIterator[None]:
    """Make the block a call of the client `name` under these rules."""
    control = AccessControl()
    control.set_state(AccessState(version=1, cluster_id="c", rules=AccessRules(rules)))
    caller = Caller(kind=CallerKind.TOKEN, roles=frozenset({Role.CLIENT}), name=name)
    async with control.serving(caller, CONTEXT):
        yield


def calls_of(log: Log, *, known: Directory | None = None) -> tuple[DirectoryCalls, ReplicaBehind]:
    behind: Any = ReplicaBehind(known or log.directory, log.directory)
    return DirectoryCalls(behind, behind), behind


async def test_a_lagging_supernode_checks_the_rights_to_things_that_it_does_not_know_yet(log: Log) -> None:
    """In an earlier version, the supernode behaved as if the thing did not exist, and checked no right.

    The log then deleted the thing.
    """
    calls, behind = calls_of(log, known=Log().directory)
    channel_id = log.directory.tables.channel_ids["secret/plan"]
    async with called_by("thief", AccessRule("*", (AccessVerb.READ,), None, "*")):
        with pytest.raises(PermissionDenied, match="thief may not delete channel secret/plan"):
            await calls.check_thing(CONTEXT, AccessVerb.DELETE, AccessKind.CHANNEL, channel_id)
    assert behind.confirmed == 1


async def test_a_lagging_supernode_checks_the_owner_of_a_peer_that_it_does_not_know_yet(log: Log) -> None:
    calls, _ = calls_of(log, known=Log().directory)
    async with called_by("thief"):
        with pytest.raises(PermissionDenied, match="peer robot belongs to robot"):
            await calls.check_peer(CONTEXT, id_of(7))


async def test_a_known_thing_is_checked_without_a_confirmed_read_and_an_unknown_thing_passes(log: Log) -> None:
    calls, behind = calls_of(log)
    async with called_by("client", ALL):
        queue_id = log.directory.tables.queues.ids["jobs"]
        await calls.check_thing(CONTEXT, AccessVerb.DELETE, AccessKind.QUEUE, queue_id)
        assert behind.confirmed == 0
        await calls.check_thing(CONTEXT, AccessVerb.DELETE, AccessKind.QUEUE, id_of(99))


async def test_only_the_owner_of_a_mailbox_can_change_it_under_any_rules(log: Log) -> None:
    """A mailbox has no name.

    In an earlier version, every rule for "*" granted rights to all mailboxes, and no rule could deny them.
    """
    calls, _ = calls_of(log)
    mailbox_id = log.directory.tables.peers.by_id[id_of(7)].mailbox_queue_id
    assert mailbox_id is not None
    for rules in ((ALL,), ()):
        async with called_by("thief", *rules):
            with pytest.raises(PermissionDenied, match="peer robot belongs to robot, and thief may not act for it"):
                await calls.check_thing(CONTEXT, AccessVerb.CONFIGURE, AccessKind.QUEUE, mailbox_id)
    async with called_by("robot", AccessRule("nobody", (), None, "*")):
        await calls.check_thing(CONTEXT, AccessVerb.CONFIGURE, AccessKind.QUEUE, mailbox_id)


async def test_the_rights_to_several_unknown_things_take_one_confirmed_read(log: Log) -> None:
    calls, behind = calls_of(log, known=Log().directory)
    ids = [log.directory.tables.channel_ids["secret/plan"], *map(id_of, range(50))]
    async with called_by("thief", AccessRule("*", (AccessVerb.LIST,), None, "*")):
        with pytest.raises(PermissionDenied, match="thief may not read channel secret/plan"):
            await calls.check_things(CONTEXT, AccessVerb.READ, AccessKind.CHANNEL, ids)
    assert behind.confirmed == 1


async def test_a_change_of_a_group_that_names_too_many_channels_is_refused_without_a_confirmed_read(log: Log) -> None:
    """In an earlier version, one request needed a confirmed read for each unknown channel, and kept the supernode busy
    for long.
    """
    calls, behind = calls_of(log)
    codes: list[grpc.StatusCode] = []

    async def abort(code: grpc.StatusCode, *_: Any) -> None:
        codes.append(code)
        raise grpc.aio.AbortError

    context: Any = SimpleNamespace(**vars(CONTEXT), abort=abort)
    request = UpdateGroupRequest(group_id=id_of(1), add_channel_ids=map(id_of, range(5000)))
    async with called_by("anyone", ALL):
        with pytest.raises(grpc.aio.AbortError):
            await GroupDirectoryServicer(calls).UpdateGroup(request, context)
    assert codes == [grpc.StatusCode.INVALID_ARGUMENT]
    assert behind.confirmed == 0
