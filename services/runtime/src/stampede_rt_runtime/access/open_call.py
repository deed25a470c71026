"""One call under way, and the rights that the call and its requests have used."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Iterator
from itertools import islice
from typing import Any, Protocol

from stampede_rt.errors import Overloaded, PermissionDenied, StampedeError
from stampede_rt_runtime.access.audit import AuditLog
from stampede_rt_runtime.access.caller import Caller
from stampede_rt_runtime.access.refusals import denied, denied_all, revoked
from stampede_rt_runtime.access.rules import NO_RULES, AccessKind, AccessRules, AccessVerb
from stampede_rt_runtime.access.state import AccessState
from stampede_rt_runtime.quotas.accounts import Account, Accounts
from stampede_rt_runtime.quotas.limits import LIMIT_MAX, Quota
from stampede_rt_runtime.quotas.subjects import creator_of
from stampede_rt_runtime.quotas.working import TransportCosts

GRANTS_KEPT_MAX = 1024
REQUESTS_PER_STEP = 16
Grant = tuple[AccessVerb, AccessKind, str]


class CallControl(Protocol):
    """The control of the port that serves a call."""

    audit: AuditLog
    accounts: Accounts
    takes_ids: bool

    def rules(self) -> AccessRules:
        """The present rules. Raises Unavailable while there is no state."""


class OpenCall:
    """One call under way, and the rights that the call has used."""

    def __init__(
        self, control: CallControl, caller: Caller, peer: str, account: Account, costs: TransportCosts
    ) -> None:
        """Create this object in the task of the call. `peer`: the caller's address, as gRPC names it."""
        task = asyncio.current_task()
        assert task is not None, "handlers run in tasks"
        self._task: asyncio.Task[Any] | None = task
        self._peer = peer
        self.caller = caller
        self.account = account
        self.costs = costs
        self.error: StampedeError | None = None
        self._control = control
        self.ends_unix_nano = caller.first_end_unix_nano
        self.requests: RequestRights | None = None
        self._is_judged = caller.is_judged
        self._granted: dict[Grant, None] = {}  # the call ends if one of these rights is lost
        self._judged: dict[Grant, AccessRules] = {}  # allowed by these rules; a bounded cache

    def end(self, error: StampedeError) -> None:
        """Interrupt the call, wherever it waits, and end the RPC with `error`. Only the first error counts."""
        if self.error is None and self._task is not None:
            self.error = error
            self._task.cancel()

    def uncancel(self) -> None:
        """Take back the cancellation by `end`, before the call sends its error."""
        assert self._task is not None, "the call is under way"
        self._task.uncancel()

    def over(self) -> None:
        """Drop the references to the task and to the rights of the requests, at the end of the call.

        Both refer to this object. Without this step, the references form a cycle, and only Python's collector frees
        these objects and everything that gRPC keeps of the call.
        """
        self._task = self.requests = None

    def rules(self) -> AccessRules:
        """The present rules for this call. Raises Unavailable."""
        return self._control.rules() if self._is_judged else NO_RULES

    def check(self, grant: Grant) -> None:
        """Raises PermissionDenied if the caller has no such right by the present rules.

        The call remembers a right that the caller has, and ends when the caller loses it.
        """
        if self._is_judged:
            self.check_now(grant)
            self._granted[grant] = None

    def check_now(self, grant: Grant) -> None:
        """Like `check`, but the call continues if the caller loses the right later."""
        if not self._is_judged:
            return
        rules = self.rules()
        if self._judged.get(grant) is rules:
            return
        if not rules.judge(self.caller, *grant).allowed:
            raise self.denial(grant, rules)
        if len(self._judged) >= GRANTS_KEPT_MAX:
            self._judged.clear()
        self._judged[grant] = rules

    def judging_again(self, state: AccessState) -> Iterator[None]:
        """Check the credential and the used rights against a new state. End the call, or some of its requests, if one
        is lost.

        Yields after each right, so that the caller can pause.
        """
        if without := self.caller.revoked_among(state.revoked_serials):
            self.end(revoked(without))
            return
        for grant in tuple(self._granted):  # the new rules judge the things that the call uses meanwhile
            if not state.rules.judge(self.caller, *grant).allowed:
                self.end(self.denial(grant, state.rules))
                return
            yield
        if self.requests is not None:
            yield from self.requests.judging_again(state.rules)

    def check_known(self, kind: AccessKind, name: str, *, by_id: bool) -> None:
        """Raises PermissionDenied if the caller may do nothing with the thing. `by_id`: it gave only the thing's id."""
        if not self.rules().knows_of(self.caller, kind, name):
            hides_name = by_id or self._control.takes_ids
            raise self.denied(denied_all(self.caller, kind, "" if hides_name else name), "find", kind, name)

    def denial(self, grant: Grant, rules: AccessRules) -> PermissionDenied:
        """The error for a caller without that right, which is written to the audit log."""
        _, kind, name = grant
        if self._control.takes_ids and not rules.knows_of(self.caller, kind, name):
            return self.denied(denied_all(self.caller, kind), *grant)
        return self.denied(denied(self.caller, *grant), *grant)

    def denied(self, error: PermissionDenied, verb: str, kind: AccessKind, name: str) -> PermissionDenied:
        """Write `error` to the audit log, and return it."""
        self._control.audit.denied(self.caller, self._peer, verb, f"{kind} {name}")
        return error

    def changed(self, what: str, name: str, *, done: bool) -> None:
        """Write a change by the call to the audit log."""
        self._control.audit.changed(self.caller, self._peer, what, name, done=done)

    def count_refusal(self, error: Overloaded) -> None:
        """Count a refusal by a quota, see `Accounts.count_refusal`."""
        self._control.accounts.count_refusal(error)

    def creation_limit(self, quota: Quota) -> int | None:
        """See `control.creation_limit`."""
        name = creator_of(self.caller)
        limit = LIMIT_MAX if name is None else self._control.accounts.of(name).limit(quota)
        return None if limit >= LIMIT_MAX else limit


class RequestRights:
    """The rights that the requests of one stream use. If the caller loses a right, only the requests that need it end.

    The stream continues, because it may serve things that the caller may still use. `lose(request, error)` ends one
    waiting request. All methods may be called in the context of another call.
    """

    def __init__(self, call: OpenCall | None, lose: Callable[[Any, PermissionDenied], None]) -> None:
        """`call` None: everything is allowed, as in tests of single methods."""
        self._call = call
        self._lose = lose
        self._waiting: dict[Grant, dict[Hashable, None]] = {}
        self._grants_of_requests: dict[Hashable, list[Grant]] = {}
        if call is not None:
            call.requests = self

    def check(self, verb: AccessVerb, kind: AccessKind, name: str) -> None:
        """Raises PermissionDenied if the caller has no such right by the present rules."""
        if self._call is not None:
            self._call.check_now((verb, kind, name))

    def hold(self, request: Hashable, verb: AccessVerb, kind: AccessKind, name: str) -> None:
        """Note that a request waits, and needs this right. `release` must follow."""
        if self._call is not None and self._call.caller.is_judged:
            grant = (verb, kind, name)
            self._waiting.setdefault(grant, {})[request] = None
            self._grants_of_requests.setdefault(request, []).append(grant)

    def release(self, request: Hashable) -> None:
        """Note that a request no longer waits. Idempotent."""
        for grant in self._grants_of_requests.pop(request, ()):
            waiting = self._waiting.get(grant)
            if waiting is not None:
                waiting.pop(request, None)
                if not waiting:
                    del self._waiting[grant]

    def close(self) -> None:
        """Drop `lose`, at the end of the stream.

        `lose` usually refers to the stream, and the stream to this object. Only Python's collector would free such a
        cycle.
        """
        self._lose = lambda *_: None

    def judging_again(self, rules: AccessRules) -> Iterator[None]:
        """End the waiting requests that need a right which the caller has lost. Yields after each bounded step."""
        assert self._call is not None, "only a call is judged"
        for grant in tuple(self._waiting):
            if not rules.judge(self._call.caller, *grant).allowed:
                error = self._call.denial(grant, rules)
                while lost := [*islice(self._waiting.get(grant, ()), REQUESTS_PER_STEP)]:
                    for request in lost:
                        self.release(request)
                        self._lose(request, error)
                    yield
            yield
