"""The access control of one port: the present rules and keys, and the calls that depend on them."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Iterator
from contextvars import ContextVar
from sys import intern
from typing import Any

from stampede_rt.errors import Overloaded, PermissionDenied, Unavailable
from stampede_rt.status import abort
from stampede_rt_runtime.access.audit import AuditLog
from stampede_rt_runtime.access.caller import Caller
from stampede_rt_runtime.access.open_call import OpenCall, RequestRights
from stampede_rt_runtime.access.refusals import over, revoked
from stampede_rt_runtime.access.rules import AccessKind, AccessRules, AccessVerb
from stampede_rt_runtime.access.state import AccessState
from stampede_rt_runtime.access.tokens import TokenClaims, check_not_over, is_token, read_token
from stampede_rt_runtime.quotas.accounts import Account, Accounts, unlimited
from stampede_rt_runtime.quotas.limits import SHARED_NAMES, Quota
from stampede_rt_runtime.quotas.subjects import subject_of
from stampede_rt_runtime.quotas.working import CallerWork, costs_of, loop_shares

logger = logging.getLogger(__name__)

TOKENS_KEPT_MAX = 4096
CALLS_PER_TURN = 2
RIGHTS_PER_TURN = 8
"""With a thousand rules it takes 1.5 ms to judge the first right of a caller, and 0.1 ms for each further right."""
CALLS_ENDED_PER_TURN = 16
CALLS_LOOKED_AT_PER_TURN = 256
"""A look at 3000 calls takes 1.8 ms."""
SWEEP_SECONDS = 1.0
"""The time between two looks for calls whose credential has ended."""


class AccessControl:
    """Judges the callers of one port, on the event loop that serves the port.

    The state has the rules, the keys of tokens and the quotas. It comes from `source`, or else from `set_state`. As
    long as there is no state, the port refuses all callers whom rules judge.
    """

    def __init__(
        self, source: Callable[[], AccessState] | None = None, *, time_unix_nano: Callable[[], int] = time.time_ns
    ) -> None:
        self._source = source
        self._state: AccessState | None = None
        self._changed = asyncio.Event()  # set at each change of the state
        self._time_unix_nano = time_unix_nano
        self._tokens: OrderedDict[str, TokenClaims] = OrderedDict()
        self._open: set[OpenCall] = set()
        # kept here, because the loop keeps only weak references to its tasks
        self._judging: asyncio.Task[None] | None = None
        self._sweep: asyncio.Handle | None = None
        self.audit = AuditLog()
        self.takes_ids = False
        """Whether callers of this port know things by id, so that its errors must not show hidden names."""
        self.accounts = Accounts(clock_s=time.monotonic, loop_shares=loop_shares())

    def draw_from(self, source: Callable[[], AccessState]) -> None:
        """Set the function that returns the present state. `refresh` calls it."""
        self._source = source

    def set_state(self, state: AccessState) -> None:
        """Set the state.

        Ends the open calls whose caller has lost the credential, or a right that the call has used.
        """
        former, self._state = self._state, state
        self._changed.set()
        if former is None or former.quotas is not state.quotas:
            self.accounts.set_table(state.quotas)
        if former is not None and former.token_keys != state.token_keys:
            self._tokens.clear()
        if self._open and (former is None or former.version != state.version):
            # the task of an earlier state stops by itself
            self._judging = asyncio.create_task(self._judge_again(state))

    async def _judge_again(self, state: AccessState) -> None:
        """Judge the open calls again, a few rights in each turn of the loop.

        There may be thousands of calls, and a thousand rules.
        """
        for number, call in enumerate(tuple(self._open), start=1):
            for judged, _ in enumerate(call.judging_again(state), start=1):
                if judged % RIGHTS_PER_TURN == 0:
                    await asyncio.sleep(0)
                    if state is not self._state:
                        return
            if number % CALLS_PER_TURN == 0:
                await asyncio.sleep(0)
                if state is not self._state:
                    return

    @property
    def lacks_state(self) -> bool:
        """Whether this port has not received the state from the directory yet."""
        return self._state is None and self._source is None

    @property
    def lacks_keys(self) -> bool:
        """Whether this port has not received the keys of tokens yet. A new cluster has no keys for a moment."""
        return self._source is None and (self._state is None or not self._state.token_keys)

    async def wait_while(self, is_missing: Callable[[], bool], seconds_max: float) -> None:
        """Wait for changes of the state until `is_missing` returns False, for `seconds_max` at most."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds_max):
                while is_missing():
                    self._changed.clear()
                    await self._changed.wait()

    @property
    def version(self) -> int:
        """The log position of the last change of the state; 0: there is no state."""
        state = self.refresh()
        return 0 if state is None else state.version

    def refresh(self) -> AccessState | None:
        """Get the state from the source, if there is a source. Returns the present state; None: there is none yet."""
        if self._source is not None:
            state = self._source()
            if state != self._state:
                self.set_state(state)
        return self._state

    def limits(self, caller: Caller | None) -> bool:
        """Whether the rules limit `caller`."""
        state = self.refresh()
        return state is not None and caller is not None and caller.is_judged and bool(state.rules.rules)

    def rules(self) -> AccessRules:
        """The present rules. Raises Unavailable while there is no state."""
        return self._known().rules

    def read_token(self, text: str) -> Caller | None:
        """The caller of the token `text`; None if it is not a token. Raises PermissionDenied, Unavailable."""
        if not is_token(text):
            return None
        state = self._known()
        if not state.token_keys:
            raise Unavailable("the service has not received the keys of client tokens yet; try again in a moment")
        claims = self._tokens.get(text)
        if claims is None:
            claims = read_token(text, keys=state.token_keys, cluster_id=state.cluster_id)
            self._tokens[text] = claims
            if len(self._tokens) > TOKENS_KEPT_MAX:
                self._tokens.popitem(last=False)
        check_not_over(claims, now_unix_nano=self._time_unix_nano())
        return claims.caller()

    def check_valid(self, caller: Caller) -> None:
        """Check that the caller's certificate or token was not revoked and has not ended.

        A connection may last for days, and its handshake checks the end of the certificate only once. Raises
        PermissionDenied with reason UNAUTHENTICATED, or Unavailable with reason CERTIFICATE_EXPIRED or TOKEN_EXPIRED.
        """
        state = self.refresh() if caller.may_end else None
        if state is not None and (without := caller.revoked_among(state.revoked_serials)):
            raise revoked(without)
        if ended := caller.ended_by(self._time_unix_nano()):
            raise over(ended)

    def _known(self) -> AccessState:
        state = self.refresh()
        if state is None:
            raise Unavailable(
                "the service has not received the rules of access from the directory yet; try again in a moment"
            )
        return state

    @contextlib.asynccontextmanager
    async def serving(self, caller: Caller, context: Any, *, closed_to_clients: bool = False) -> AsyncIterator[None]:
        """A context in which a call of `caller` runs. Ends the call if the caller's credential or rights end.

        `closed_to_clients`: the call counts towards no quota.
        """
        peer = context.peer()
        account = self.accounts.of(None if closed_to_clients else subject_of(caller, peer))
        call = OpenCall(self, caller, peer, account, costs_of(context))
        _CURRENT.set(call)  # for the rest of the call, which has a task of its own
        try:
            async with self._until_rights_end(call, context):
                yield
        finally:
            call.over()

    @contextlib.asynccontextmanager
    async def _until_rights_end(self, call: OpenCall, context: Any) -> AsyncIterator[None]:
        """A context in which the call ends when its caller's credential or rights end."""
        caller = call.caller
        if not (caller.is_judged or caller.may_end):
            yield
            return
        self._open.add(call)
        self._sweep_soon()
        try:
            yield
        except asyncio.CancelledError:
            if call.error is None:
                raise
            call.uncancel()
            await abort(context, call.error)
        finally:
            self._open.discard(call)

    def _sweep_soon(self) -> None:
        if self._sweep is None:
            self._sweep = asyncio.get_running_loop().call_later(SWEEP_SECONDS, self._end_expired_calls)

    def _end_expired_calls(self, remaining: Iterator[OpenCall] | None = None) -> None:
        """End the calls whose credential has expired. Look at some calls now, and at the others in the next turns.

        `remaining`: the calls that earlier turns have not looked at; None: all open calls. After the last call, set the
        timer for the next sweep if any call is open.
        """
        remaining, now, ended = remaining or iter(tuple(self._open)), self._time_unix_nano(), 0
        for looked_at, call in enumerate(remaining, start=1):
            if 0 < call.ends_unix_nano <= now and call.error is None and call in self._open:
                call.end(over(call.caller.ended_by(now) or call.caller))
                ended += 1
            if looked_at == CALLS_LOOKED_AT_PER_TURN or ended == CALLS_ENDED_PER_TURN:
                self._sweep = asyncio.get_running_loop().call_soon(self._end_expired_calls, remaining)
                return
        self._sweep = None
        if self._open:
            self._sweep_soon()


_CURRENT: ContextVar[OpenCall | None] = ContextVar("call", default=None)


def current_caller() -> Caller | None:
    """The caller of the present call; None outside a server, as in tests of single methods."""
    call = _CURRENT.get()
    return None if call is None else call.caller


def is_denied() -> bool:
    """Whether the present call is ending because its caller has lost its credential or a right."""
    call = _CURRENT.get()
    return call is not None and call.error is not None


def current_work() -> CallerWork:
    """A new CallerWork for the present call's caller: for the call, for a task of the call, or for one stream."""
    call = _CURRENT.get()
    return CallerWork(unlimited()) if call is None else CallerWork(call.account, call.costs)


def creation_limit(quota: Quota) -> int | None:
    """The most channels, queues, groups or peers that the present call's caller may have created; None: no limit."""
    call = _CURRENT.get()
    return None if call is None else call.creation_limit(quota)


def count_refusal(error: Overloaded) -> None:
    """Count a refusal by a quota that the directory counts, towards the present call's port."""
    call = _CURRENT.get()
    if call is not None:
        call.count_refusal(error)


def current_account() -> Account:
    """The account of the present call's caller, with its quotas; outside a server, an account without limits."""
    call = _CURRENT.get()
    return unlimited() if call is None else call.account


def check_access(verb: AccessVerb, kind: AccessKind, name: str) -> None:
    """Check that the present call's caller may do `verb` with the thing. Raises PermissionDenied, Unavailable.

    The call ends when its caller loses this right. A stream that serves many things takes `request_rights` instead.
    """
    call = _CURRENT.get()
    if call is not None:
        call.check((verb, kind, name))


def request_rights(lose: Callable[[Any, PermissionDenied], None]) -> RequestRights:
    """The rights of the requests of the present call, which is a stream. `lose`: see `RequestRights`.

    Call it once for each stream.
    """
    return RequestRights(_CURRENT.get(), lose)


def check_known(kind: AccessKind, name: str, *, by_id: bool = False) -> None:
    """Check that the present call's caller may do at least one kind of action with the thing.

    `by_id`: the caller gave only the thing's id. The error then does not show the name. Raises PermissionDenied,
    Unavailable.
    """
    call = _CURRENT.get()
    if call is not None:
        call.check_known(kind, name, by_id=by_id)


def allowed_to(verb: AccessVerb, kind: AccessKind) -> Callable[[str], bool]:
    """A function that returns whether the present call's caller may do `verb` with the thing of a name.

    It applies the present rules at each call. Raises Unavailable.
    """
    call = _CURRENT.get()
    if call is None or not call.caller.is_judged:
        return lambda name: True
    return lambda name: call.rules().judge(call.caller, verb, kind, name).allowed


def check_not_judged(what: str) -> None:
    """Raises PermissionDenied for a caller whom rules judge.

    `what`: an action of services of the cluster, which no rule can allow to others.
    """
    caller = current_caller()
    if caller is not None and caller.is_judged:
        raise PermissionDenied(f"{caller} may not {what}, which is for services of the cluster; leave it to them")


def audit_change(what: str, name: str, *, done: bool = True) -> None:
    """Write a change by the present call to the audit log. `done` False: the change had no effect."""
    call = _CURRENT.get()
    if call is not None:
        call.changed(what, name, done=done)


def caller_name() -> str:
    """The present caller's name in rules, even if rules do not judge it; empty outside a server."""
    caller = current_caller()
    return "" if caller is None else caller.name


def shown_name() -> str:
    """The present caller's verified name, or else its address, such as "@10.0.0.3"; empty outside a server."""
    return intern(current_account().subject or caller_name())


def owner_name() -> str:
    """The name under which the present caller owns things; empty for a caller whom rules do not judge."""
    caller = current_caller()
    return caller.name if caller is not None and caller.is_judged else ""


def own_name() -> str:
    """The present caller's name in shares; empty for callers without a name of their own, who have no limit."""
    name = owner_name()
    return "" if name in SHARED_NAMES else intern(name)
