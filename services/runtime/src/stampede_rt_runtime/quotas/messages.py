"""Converts quotas from and to protobuf. Makes no decisions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import quota_pb2 as pb
from stampede_rt_runtime.quotas.accounts import QuotaUse
from stampede_rt_runtime.quotas.limits import Quota, QuotaSetting

KINDS: Mapping[Quota, pb.QuotaKind] = {quota: getattr(pb, f"QUOTA_KIND_{quota.name}") for quota in Quota}
_KINDS_FROM: Mapping[int, Quota] = {int(number): quota for quota, number in KINDS.items()}


def setting_message(setting: QuotaSetting) -> pb.QuotaSetting:
    """The message of a setting."""
    return pb.QuotaSetting(who=setting.who, kind=KINDS[setting.quota], limit=setting.limit)


def setting_from(message: pb.QuotaSetting) -> QuotaSetting:
    """The setting of a message. Raises InvalidArgument for an unknown quota."""
    return QuotaSetting(message.who, quota_from(message.kind), message.limit)


def known_settings(messages: Iterable[pb.QuotaSetting]) -> Iterator[QuotaSetting]:
    """The settings of the quotas that this release knows. A newer supernode may send other quotas, too."""
    return (setting_from(one) for one in messages if one.kind in _KINDS_FROM)


def quota_from(number: int) -> Quota:
    """The quota of a number. Raises InvalidArgument."""
    if number not in _KINDS_FROM:
        raise InvalidArgument(f"this service knows no quota {number}; name one of QuotaKind")
    return _KINDS_FROM[number]


def limit_message(quota: Quota, limit: int, setting: QuotaSetting | None) -> pb.QuotaLimit:
    """The message of a limit. `setting` None: the default counts."""
    encoded = None if setting is None else setting_message(setting)
    return pb.QuotaLimit(kind=KINDS[quota], limit=limit, setting=encoded)


def use_messages(uses: Iterable[QuotaUse], uses_max: int) -> list[pb.QuotaUse]:
    """At most `uses_max` uses: first the uses with the most refusals, then the uses nearest to their limits."""
    chosen = sorted(uses, key=lambda use: (use.refused, use.used / max(1, use.limit)), reverse=True)[:uses_max]
    return [
        pb.QuotaUse(subject=use.subject, kind=KINDS[use.quota], used=use.used, limit=use.limit, refused=use.refused)
        for use in chosen
    ]
