"""Serves QuotaService (proto/stampede_rt/v1/quota_service.proto). Each method checks the request, asks the core or the
log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import quota_service_pb2 as pb
from stampede_rt.v1 import quota_service_pb2_grpc
from stampede_rt_runtime.access.control import audit_change
from stampede_rt_runtime.quotas.limits import DEFAULTS, LIMIT_MAX, Quota, check_effective, check_who
from stampede_rt_runtime.quotas.messages import limit_message, quota_from, setting_from, setting_message
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.core.access.quota_commands import QuotasRemoved, QuotasSet, RemoveQuotas, SetQuotas
from stampede_rt_supernode.core.cluster.feature_levels import ARCHIVE_LEVEL, GROUPS_AND_PEERS_LEVEL
from stampede_rt_supernode.servicers.calls import DirectoryCalls

# Members of a release below this feature level cannot read a command about the quota.
LATER_QUOTAS = {
    Quota.GROUPS: GROUPS_AND_PEERS_LEVEL,
    Quota.PEERS: GROUPS_AND_PEERS_LEVEL,
    Quota.BYTES_ARCHIVED: ARCHIVE_LEVEL,
}


class QuotaServicer(quota_service_pb2_grpc.QuotaServiceServicer):
    """One supernode's answers about quotas."""

    def __init__(self, calls: DirectoryCalls) -> None:
        self._calls = calls

    @errors_as_status
    async def SetQuotas(self, request: pb.SetQuotasRequest, context: Context) -> pb.SetQuotasResponse:
        operation = SetQuotas(settings=tuple(map(setting_from, request.settings)))
        for setting in operation.settings:
            check_effective(setting)
        await self.check_known_to_all(context, [one.quota for one in operation.settings])
        done = await self._calls.submit(context, operation, QuotasSet, request.request_id)
        audit_change("set quota", ", ".join(map(str, operation.settings)), done=bool(done.changed))
        return pb.SetQuotasResponse(changed=done.changed, version=done.version)

    @errors_as_status
    async def RemoveQuotas(self, request: pb.RemoveQuotasRequest, context: Context) -> pb.RemoveQuotasResponse:
        operation = RemoveQuotas(who=request.who, quotas=tuple(map(quota_from, request.kinds)))
        await self.check_known_to_all(context, operation.quotas)
        done = await self._calls.submit(context, operation, QuotasRemoved, request.request_id)
        audit_change("remove quota", f"{operation.who} {' '.join(operation.quotas) or 'all'}", done=bool(done.removed))
        return pb.RemoveQuotasResponse(removed=done.removed, version=done.version)

    async def check_known_to_all(self, context: Context, quotas: Iterable[Quota]) -> None:
        """Check that all supernodes know these quotas. Raises VersionMismatch."""
        for quota in sorted(LATER_QUOTAS.keys() & set(quotas)):
            await self._calls.check_level(context, f"the quota {quota}", LATER_QUOTAS[quota])

    @errors_as_status
    async def ListQuotas(self, request: pb.ListQuotasRequest, context: Context) -> pb.ListQuotasResponse:
        table = await self._calls.read(context, lambda directory: directory.access.quotas, stale_ok=request.stale_ok)
        return pb.ListQuotasResponse(
            settings=map(setting_message, table.settings),
            defaults=[limit_message(quota, limit, None) for quota, limit in DEFAULTS.items()],
        )

    @errors_as_status
    async def CheckQuotas(self, request: pb.CheckQuotasRequest, context: Context) -> pb.CheckQuotasResponse:
        """Answers with the limits of one caller, and the settings from which they come."""
        check_who(request.subject)
        if set(request.subject) & {"*", "?"}:
            raise InvalidArgument(f"{request.subject} is a pattern; name one caller")
        table = await self._calls.read(context, lambda directory: directory.access.quotas)
        limits = table.limits_of(request.subject)
        return pb.CheckQuotasResponse(
            limits=[
                limit_message(quota, limits.get(quota, LIMIT_MAX), table.setting_for(request.subject, quota))
                for quota in Quota
            ]
        )
