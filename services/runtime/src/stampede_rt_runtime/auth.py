"""The shared secret of a cluster without certificates: making its file, and asking every caller for it."""

from __future__ import annotations

import hmac
import os
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grpc

from stampede_rt.errors import PermissionDenied
from stampede_rt.security.credentials import read_secret, secret_file
from stampede_rt.status import abort
from stampede_rt_runtime.written import naming

_OPEN_METHODS = frozenset({"/grpc.health.v1.Health/Check"})
_SCHEME = "Bearer "


@dataclass(frozen=True, kw_only=True, slots=True)
class Secret:
    """The secret and where it lies. Never logged: `repr` leaves the text out."""

    text: str = field(repr=False)
    path: Path


def load_secret(path: Path | None) -> Secret | None:
    """The secret in `path`, which must exist, or else in the user's default file, which may be absent (None).

    Raises PermissionDenied if the file is missing, empty, or may be read by others.
    """
    secret_path = path or secret_file()
    text = read_secret(secret_path)
    if text is None:
        if path is None and "STAMPEDE_SECRET_FILE" not in os.environ:
            return None
        raise PermissionDenied(f"there is no secret file {secret_path}; make one with `stampede dev`, or name another")
    if not text:
        raise PermissionDenied(f"the secret file {secret_path} is empty; remove it, and `stampede dev` makes a new one")
    return Secret(text=text, path=secret_path)


def make_secret_file(path: Path | None = None) -> Secret:
    """The secret in `path` (default: the user's file), made first if there is none.

    The file appears whole, with mode 0600, or not at all; of several makers at once one wins and all return its
    secret. Raises PermissionDenied if the file is empty or may be read by others, OSError if it cannot be written.
    """
    secret_path = path or secret_file()
    if not secret_path.exists():
        _create(secret_path)
    found = load_secret(secret_path)
    assert found is not None, "an explicit path never gives None"
    return found


def _create(secret_path: Path) -> None:
    secret_path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    draft = secret_path.with_name(f".{secret_path.name}.{secrets.token_hex(8)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with naming(secret_path), os.fdopen(descriptor, "w") as file:
            file.write(secrets.token_urlsafe(32) + "\n")
        os.link(draft, secret_path)  # unlike rename, refuses to replace: the first maker wins
    except FileExistsError:
        pass  # another process made it meanwhile; its secret is the one
    finally:
        draft.unlink()


class SecretInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """Refuses every call that does not bring the secret, except the health check, which load balancers make."""

    def __init__(self, secret: Secret) -> None:
        self._expected = (_SCHEME + secret.text).encode()
        self._refusal: grpc.RpcMethodHandler[Any, Any] = grpc.stream_stream_rpc_method_handler(_refuse)

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[grpc.RpcMethodHandler[Any, Any] | None]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> grpc.RpcMethodHandler[Any, Any] | None:
        """The method's handler, or one that refuses."""
        if handler_call_details.method in _OPEN_METHODS or self._brings_secret(handler_call_details):
            return await continuation(handler_call_details)
        return self._refusal

    def _brings_secret(self, details: grpc.HandlerCallDetails) -> bool:
        for key, value in details.invocation_metadata:
            if key == "authorization":
                given = value if isinstance(value, bytes) else value.encode()
                return hmac.compare_digest(given, self._expected)
        return False


async def _refuse(_requests: Any, context: grpc.aio.ServicerContext[Any, Any]) -> None:
    """Stream-stream on purpose: on the wire it serves every kind of call, and it answers before any request comes."""
    brought = any(key == "authorization" for key, _ in context.invocation_metadata() or ())
    searched_files = (
        "the file that --secret-file or $STAMPEDE_SECRET_FILE names, else $XDG_CONFIG_HOME/stampede/secret, else "
        "~/.config/stampede/secret"
    )
    if brought:
        what = "the call brought a secret that differs from the service's"
        remedy = f"the caller read its secret from {searched_files}: replace that file by the service's own"
    else:
        what = "the call brought no secret"
        remedy = (
            f"copy the service's secret file to one of the files that callers read: {searched_files}. A client sends "
            "it to another machine only if $STAMPEDE_SECRET_FILE, or connect(secret=...), names it"
        )
    await abort(context, PermissionDenied(f"{what}; {remedy}", reason="UNAUTHENTICATED"))
