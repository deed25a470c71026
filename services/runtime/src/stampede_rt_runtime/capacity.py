"""Limits the calls that a port serves at a time: the calls of one caller, and the calls of all callers.

The limit of streams leaves room for other calls. The limit of all callers' calls leaves room for the cluster's own
calls.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc
from grpc.aio import AbortError

from stampede_rt.errors import Overloaded
from stampede_rt.status import abort, error_in
from stampede_rt_runtime.access.control import current_account, current_work
from stampede_rt_runtime.handlers import guarded, is_stream
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.overload import RefusedCalls
from stampede_rt_runtime.pacing import TurnGate
from stampede_rt_runtime.quotas.limits import LIMIT_MAX, Quota
from stampede_rt_runtime.quotas.working import CALL_NANOS
from stampede_rt_runtime.requests import reading_late
from stampede_rt_runtime.roles import is_closed_to_clients
from stampede_rt_runtime.rpc import Context


class Slots:
    """The slots of a port: `concurrent_rpcs_max` for calls of any caller, and `reserved_rpcs_max` more (see `Limits`).

    At most `streams_max` of the slots for any caller may be streams. One caller gets at most three quarters of these
    slots, rounded up, unless its quota of streams is unlimited. The reserved slots are for the methods of
    `is_closed_to_clients`.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.streams = self.singles = self.reserved = 0
        self._slots_of_callers: Counter[str] = Counter()  # the slots of each caller that has quotas

    def take(self, *, is_stream: bool, closed_to_clients: bool, subject: str = "") -> Callable[[], None]:
        """Take a slot. Returns a function that gives it back; call that function once.

        `subject`: the caller in quotas; empty if it may have all slots. Raises Overloaded if no slot is free for it.
        """
        limits = self._limits
        if closed_to_clients and self.reserved < limits.reserved_rpcs_max:
            kind = "reserved"
        elif is_stream and self.streams >= limits.streams_max:
            raise Overloaded(
                f"{limits.streams_max} streams are open at this port, as many as it serves; close some "
                "subscriptions or watches, or go to another supernode or host"
            )
        elif self.streams + self.singles >= limits.concurrent_rpcs_max:
            raise Overloaded(
                f"{limits.concurrent_rpcs_max} calls are under way at this port, as many as it serves; try "
                "again in a moment"
            )
        elif subject and self._slots_of_callers[subject] >= (share := -(-limits.concurrent_rpcs_max * 3 // 4)):
            raise Overloaded(
                f"{subject} has {share} calls under way at this port, the most for one caller; make fewer calls at the "
                "same time",
                metadata={"subject": subject, "used": str(share), "limit": str(share)},
            )
        else:
            kind = "streams" if is_stream else "singles"
        self._count(kind, subject, +1)
        return lambda: self._count(kind, subject, -1)

    def _count(self, kind: str, subject: str, step: int) -> None:
        setattr(self, kind, getattr(self, kind) + step)
        if subject and kind != "reserved":
            self._slots_of_callers[subject] += step
            if not self._slots_of_callers[subject]:
                del self._slots_of_callers[subject]


# The host counts the refused items of these streams.
COUNTED_BY_ITEMS = frozenset({"/stampede_rt.v1.ChannelService/Put", "/stampede_rt.v1.QueueService/Enqueue"})

# The calls of these methods also count as subscriptions.
SUBSCRIPTIONS = frozenset(
    f"/stampede_rt.v1.{name}"
    for name in (
        "ChannelService/Subscribe", "GroupService/SubscribeCuts", "GroupService/SubscribeMatches", "QueueService/Take",
        "DirectoryService/Watch", "PeerService/WatchPeers",
    )
)  # fmt: skip


def quotas_of(method: str, *, is_stream: bool) -> tuple[Quota, ...]:
    """The quotas towards which each call of a method counts."""
    if method in SUBSCRIPTIONS:
        return Quota.STREAMS, Quota.SUBSCRIPTIONS
    return (Quota.STREAMS,) if is_stream else (Quota.WAITING_CALLS,)


class CapacityInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """Admits a call if its caller's quotas have room and the port has a free slot. Otherwise refuses the call.

    The server reads and parses the requests of the call only after that. This interceptor must come after the
    interceptors that check the caller.
    """

    def __init__(self, slots: Slots, refused: RefusedCalls) -> None:
        """`refused` counts the calls refused here, and all other calls that end with Overloaded."""
        self._slots, self._requests = slots, TurnGate()
        self._refused = refused

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, which takes a slot first."""
        handler = await continuation(handler_call_details)
        if handler is None:
            return None
        method, streams = handler_call_details.method, is_stream(handler)
        closed_to_clients = is_closed_to_clients(method)

        quotas = quotas_of(method, is_stream=streams)

        @contextlib.asynccontextmanager
        async def slot(context: Context) -> AsyncIterator[None]:
            account, work = current_account(), current_work()
            work.spend(CALL_NANOS)
            try:
                for quota in quotas:
                    account.check(quota)
                sharing = account.subject if account.limit(Quota.STREAMS) < LIMIT_MAX else ""
                give_back = self._slots.take(is_stream=streams, closed_to_clients=closed_to_clients, subject=sharing)
            except Overloaded as error:
                self._refused.note(error)
                await abort(context, error)
            account.take(quotas)
            try:
                if work.must_wait:
                    await work.turn()
                yield
            except AbortError:
                if method not in COUNTED_BY_ITEMS:
                    self._note(context)
                raise
            finally:
                account.give_back(quotas)
                give_back()

        return guarded(reading_late(method, handler, self._requests), slot)

    def _note(self, context: Context) -> None:
        """Count the call if it ended with Overloaded."""
        error = error_in(context.trailing_metadata())
        if isinstance(error, Overloaded):
            self._refused.note(error)
