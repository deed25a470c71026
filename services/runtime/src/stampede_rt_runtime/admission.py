"""Admits a call by the credential that its caller brings (a certificate, token or secret) and by the caller's roles."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import lru_cache
from typing import Any

import grpc

from stampede_rt.errors import PermissionDenied, StampedeError, Unavailable
from stampede_rt.status import abort
from stampede_rt_runtime.access.caller import Caller, CallerCertificate
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.access.credentials import AcceptedCredentials, identify, identify_by_certificate
from stampede_rt_runtime.handlers import guarded
from stampede_rt_runtime.identity import Identity, identity_among
from stampede_rt_runtime.roles import is_closed_to_clients, why_refused
from stampede_rt_runtime.rpc import Context

CERTIFICATES_KEPT_MAX = 4096  # the most certificates whose serial number and end this process remembers
STATE_SECONDS_MAX = 2.0
"""The time that a call waits, after this process starts, until the service has the rules and the keys of tokens."""
_WITHOUT_SECRET = frozenset({"/grpc.health.v1.Health/Check"})  # load balancers and container runtimes call it


def caller_identity(context: Context) -> Identity | None:
    """The identity in the caller's certificate; None without a certificate, or if it has not exactly one identity."""
    found = context.auth_context().get("peer_uri", ())
    return identity_among(uri.decode(errors="replace") for uri in found)


class AdmissionInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """Refuses every call whose caller brings no accepted credential, or whose caller may not make the call."""

    def __init__(self, accepted: AcceptedCredentials, control: AccessControl) -> None:
        self._accepted = accepted
        self._control = control

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, which checks the caller first."""
        method = handler_call_details.method
        handler = await continuation(handler_call_details)
        if handler is None:
            return self._unknown(method)

        closed_to_clients = is_closed_to_clients(method)

        @contextlib.asynccontextmanager
        async def admitted(context: Context) -> AsyncIterator[None]:
            try:
                if self._control.lacks_keys:
                    await self._control.wait_while(lambda: self._is_too_early(method, context), STATE_SECONDS_MAX)
                caller = self._admit(method, context)
            except StampedeError as error:
                await abort(context, error)
            async with self._control.serving(caller, context, closed_to_clients=closed_to_clients):
                yield

        return guarded(handler, admitted)

    def _unknown(self, method: str) -> Any:
        """A handler for unknown methods. Only a caller with a credential learns that the method is unknown.

        It is a stream-stream handler, because such a handler serves every kind of call on the wire. It answers before
        any request comes.
        """

        async def refuse(_requests: Any, context: Context) -> None:
            try:
                self._caller(method, context)
            except StampedeError as error:
                await abort(context, error)
            await context.abort(grpc.StatusCode.UNIMPLEMENTED, f"Method not found: {method}")

        return grpc.stream_stream_rpc_method_handler(refuse)

    def _admit(self, method: str, context: Context) -> Caller:
        """The caller, if it may make the call.

        Raises PermissionDenied or Unavailable. The audit log gets each denial, and each call with an ended certificate.
        """
        caller: Caller | None = None
        try:
            caller = self._caller(method, context)
            self._control.check_valid(caller)
            if refusal := why_refused(method, caller):
                raise PermissionDenied(refusal)
        except (PermissionDenied, Unavailable) as error:
            if isinstance(error, PermissionDenied) or error.reason == "CERTIFICATE_EXPIRED":
                self._control.audit.denied(caller, context.peer(), method.rpartition(".")[2], "")
            raise
        return caller

    def _is_too_early(self, method: str, context: Context) -> bool:
        """Whether this service must wait for the rules, or for the keys of tokens, before it can admit the caller."""
        try:
            caller = self._caller(method, context)
        except Unavailable:  # it brings a token, and the service does not know the keys of tokens yet
            return True
        except PermissionDenied:
            return False
        return self._control.lacks_state and caller.is_judged and not why_refused(method, caller)

    def _caller(self, method: str, context: Context) -> Caller:
        certificate = _caller_certificate(context) if self._accepted.cluster else None
        if method in _WITHOUT_SECRET:
            return identify_by_certificate(self._accepted, certificate)
        return identify(self._accepted, _authorization(context), certificate)


def _caller_certificate(context: Context) -> CallerCertificate | None:
    identity = caller_identity(context)
    found = tuple(context.auth_context().get("x509_pem_cert", ()))
    return None if identity is None else CallerCertificate(identity, *(_serial_and_end(found[0]) if found else ()))


@lru_cache(CERTIFICATES_KEPT_MAX)
def _serial_and_end(pem: bytes) -> tuple[str, int]:
    from stampede_rt_runtime.certificates import serial_and_end  # not at the top: needed only with certificates

    return serial_and_end(pem)


def _authorization(context: Context) -> bytes | None:
    for key, value in context.invocation_metadata() or ():
        if key == "authorization":
            return value if isinstance(value, bytes) else value.encode()
    return None
