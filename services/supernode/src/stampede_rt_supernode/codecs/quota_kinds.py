"""Converts commands about quotas, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_runtime.quotas.messages import KINDS, quota_from, setting_from, setting_message
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.core.access.quota_commands import QuotasRemoved, QuotasSet, RemoveQuotas, SetQuotas

CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="set_quotas",
        outcome="quotas_set",
        operation=SetQuotas,
        result=QuotasSet,
        write=lambda one: pb.SetQuotasCommand(settings=map(setting_message, one.settings)),
        read=lambda message: SetQuotas(settings=tuple(map(setting_from, message.settings))),
        write_result=lambda one: pb.QuotasSetResult(changed=one.changed, version=one.version),
        read_result=lambda message: QuotasSet(changed=message.changed, version=message.version),
    ),
    KindCodec(
        kind="remove_quotas",
        outcome="quotas_removed",
        operation=RemoveQuotas,
        result=QuotasRemoved,
        write=lambda one: pb.RemoveQuotasCommand(who=one.who, kinds=[KINDS[quota] for quota in one.quotas]),
        read=lambda message: RemoveQuotas(who=message.who, quotas=tuple(map(quota_from, message.kinds))),
        write_result=lambda one: pb.QuotasRemovedResult(removed=one.removed, version=one.version),
        read_result=lambda message: QuotasRemoved(removed=message.removed, version=message.version),
    ),
)
