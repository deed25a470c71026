"""AccessService, thinly: check, ask the core or the log, encode (proto/stampede_rt/v1/access_service.proto)."""

# ruff: noqa: N802  # methods bear the names of the RPCs
from __future__ import annotations

import secrets
from collections.abc import Callable

from stampede_rt.v1 import access_service_pb2 as pb
from stampede_rt.v1 import access_service_pb2_grpc
from stampede_rt_runtime.access.messages import rule_message
from stampede_rt_runtime.access.tokens import KEY_BYTES, VALID_NANOS_DEFAULT, TokenClaims, check_claims, make_token
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.core.access.commands import CreateTokenKey, TokenKeyCreated
from stampede_rt_supernode.core.access.queries import access_state
from stampede_rt_supernode.core.validation import check_id
from stampede_rt_supernode.servicers.calls import DirectoryCalls

SERIAL_BYTES = 8


class AccessServicer(access_service_pb2_grpc.AccessServiceServicer):
    """One supernode's answers about who may do what."""

    def __init__(self, calls: DirectoryCalls, time_unix_nano: Callable[[], int]) -> None:
        self._calls = calls
        self._time_unix_nano = time_unix_nano

    @errors_as_status
    async def CreateClientToken(
        self, request: pb.CreateClientTokenRequest, context: Context
    ) -> pb.CreateClientTokenResponse:
        """A cluster that was founded before there were client tokens gets its key with the first one."""
        check_id(request.request_id, "request_id")
        valid_nanos = request.valid_nanos if request.HasField("valid_nanos") else VALID_NANOS_DEFAULT
        roles = check_claims(request.name, request.roles, valid_nanos)
        token_key = await self._calls.read(context, lambda directory: directory.access.token_key)
        if not token_key:
            operation = CreateTokenKey(new_token_key=secrets.token_bytes(KEY_BYTES))
            await self._calls.submit(context, operation, TokenKeyCreated, request.request_id)
            token_key = await self._calls.read(context, lambda directory: directory.access.token_key)
        claims = TokenClaims(
            cluster_id=await self._calls.read(context, lambda directory: directory.cluster_id, stale_ok=True),
            name=request.name,
            roles=roles,
            serial=secrets.token_hex(SERIAL_BYTES),
            ends_unix_nano=self._time_unix_nano() + valid_nanos,
        )
        return pb.CreateClientTokenResponse(
            token=make_token(token_key, claims), serial=claims.serial, valid_until_unix_nano=claims.ends_unix_nano
        )

    @errors_as_status
    async def GetAccessState(self, request: pb.GetAccessStateRequest, context: Context) -> pb.GetAccessStateResponse:
        state = await self._calls.read(context, access_state, stale_ok=request.stale_ok)
        return pb.GetAccessStateResponse(
            version=state.version,
            cluster_id=state.cluster_id,
            rules=map(rule_message, state.rules.rules),
            token_keys=state.token_keys,
        )
