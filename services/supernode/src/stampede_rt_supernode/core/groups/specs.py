"""Checks which specs of a group are possible, and whether two specs mean the same (paper, section 3.3). Pure."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt_supernode.core.records import GroupSpec
from stampede_rt_supernode.core.validation import check_id

MEMBERS_MAX = 64
MAX_LEAD_NANOS_UNSTATED = 5 * 10**9
NANOS_MAX = 2**63 - 1
BOUNDS = ("start", "end")


def check_spec(group: str, spec: GroupSpec) -> None:
    """Raises InvalidArgument if `spec` is not possible. `group`: its name."""
    members = spec.channel_ids
    if not 1 <= len(members) <= MEMBERS_MAX:
        raise _invalid(group, "channel_ids", f"it would have {len(members)} members; 1 to {MEMBERS_MAX} are allowed")
    for one in members:
        check_id(one, "channel_ids")
    if len(set(members)) != len(members):
        raise _invalid(group, "channel_ids", "a channel is named twice; name each member once")
    if spec.reference_channel_id is not None and spec.reference_channel_id not in members:
        text = "its reference is not one of its members; name a member, or state no reference"
        raise _invalid(group, "reference_channel_id", text)
    if spec.bound not in BOUNDS:
        raise _invalid(group, "bound", f"bound is {spec.bound!r}; it must be one of {', '.join(BOUNDS)}")
    _check_nanos(group, "idle_after_nanos", spec.idle_after_nanos, 1)
    _check_nanos(group, "max_lead_nanos", spec.max_lead_nanos, 0)


def _check_nanos(group: str, field: str, value: int | None, least: int) -> None:
    if value is not None and not least <= value <= NANOS_MAX:
        raise _invalid(group, field, f"{field} is {value}; it must be {least} or more nanoseconds")


def _invalid(group: str, field: str, text: str) -> InvalidArgument:
    return InvalidArgument(f"group {group}: {text}", metadata={"group": group, "field": field})


def same_spec(one: GroupSpec, other: GroupSpec) -> bool:
    """Whether two specs mean the same. The order of members does not matter.

    A stated default means the same as an unstated field.
    """
    return _plain(one) == _plain(other)


def _plain(spec: GroupSpec) -> GroupSpec:
    lead = MAX_LEAD_NANOS_UNSTATED if spec.max_lead_nanos is None else spec.max_lead_nanos
    return replace(spec, channel_ids=tuple(sorted(spec.channel_ids)), max_lead_nanos=lead)
