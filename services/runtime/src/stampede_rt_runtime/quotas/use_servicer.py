"""QuotaUseService of one port: how much of their quotas the port's callers use."""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import quota_use_service_pb2 as pb
from stampede_rt.v1 import quota_use_service_pb2_grpc
from stampede_rt_runtime.globs import matcher
from stampede_rt_runtime.quotas.accounts import Accounts
from stampede_rt_runtime.quotas.limits import PATTERN_CHARACTERS_MAX
from stampede_rt_runtime.quotas.messages import use_messages
from stampede_rt_runtime.rpc import Context, errors_as_status

USES_MAX = 1000


class QuotaUseServicer(quota_use_service_pb2_grpc.QuotaUseServiceServicer):
    """Answers from the accounts of the port."""

    def __init__(self, accounts: Accounts) -> None:
        self._accounts = accounts

    @errors_as_status
    async def ListQuotaUse(self, request: pb.ListQuotaUseRequest, context: Context) -> pb.ListQuotaUseResponse:
        """Lists the callers that use a quota now, or that the port has refused because of a quota."""
        if len(request.subject_glob) > PATTERN_CHARACTERS_MAX:
            raise InvalidArgument(f"subject_glob has more than {PATTERN_CHARACTERS_MAX} characters")
        is_asked_for = matcher(request.subject_glob)
        uses = (use for use in self._accounts.uses() if is_asked_for(use.subject))
        return pb.ListQuotaUseResponse(uses=use_messages(uses, USES_MAX))
