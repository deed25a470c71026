"""Quotas, to and from the messages that carry them. Thin: no decision is made here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import quota_pb2 as pb
from stampede_rt_runtime.quotas.accounts import QuotaUse
from stampede_rt_runtime.quotas.limits import Quota, QuotaSetting

KINDS: Mapping[Quota, pb.QuotaKind] = {quota: getattr(pb, f"QUOTA_KIND_{quota.name}") for quota in Quota}
_KINDS_FROM: Mapping[int, Quota] = {int(number): quota for quota, number in KINDS.items()}


def setting_message(setting: QuotaSetting) -> pb.QuotaSetting:
    """The setting as it travels."""
    return pb.QuotaSetting(who=setting.who, kind=KINDS[setting.quota], limit=setting.limit)


def setting_from(message: pb.QuotaSetting) -> QuotaSetting:
    """Raises InvalidArgument for a quota that is not known."""
    return QuotaSetting(message.who, quota_from(message.kind), message.limit)


def known_settings(messages: Iterable[pb.QuotaSetting]) -> Iterator[QuotaSetting]:
    """Those of quotas that this release knows: a newer supernode may tell others, too."""
    return (setting_from(one) for one in messages if one.kind in _KINDS_FROM)


def quota_from(number: int) -> Quota:
    """Raises InvalidArgument."""
    if number not in _KINDS_FROM:
        raise InvalidArgument(f"this service knows no quota {number}; name one of QuotaKind")
    return _KINDS_FROM[number]


def limit_message(quota: Quota, limit: int, setting: QuotaSetting | None) -> pb.QuotaLimit:
    """`setting` None: the default holds."""
    told = None if setting is None else setting_message(setting)
    return pb.QuotaLimit(kind=KINDS[quota], limit=limit, setting=told)


def use_messages(uses: Iterable[QuotaUse], uses_max: int) -> list[pb.QuotaUse]:
    """The uses that matter most, first: those of refused callers, then those nearest to their limit."""
    chosen = sorted(uses, key=lambda use: (use.refused, use.used / max(1, use.limit)), reverse=True)[:uses_max]
    return [
        pb.QuotaUse(subject=use.subject, kind=KINDS[use.quota], used=use.used, limit=use.limit, refused=use.refused)
        for use in chosen
    ]
