"""Checks which policies of a channel are possible, and whether two of them agree (paper, section 3.4). Pure.

A field that is None was never stated. A stated value stays in effect until an update changes it. A later open may
repeat the value or leave it out. Only an update changes it.
"""

from __future__ import annotations

from dataclasses import fields, replace

from stampede_rt.errors import ChannelExists, InvalidArgument
from stampede_rt.values.model import OVERLAP_NANOS_MAX, Policy
from stampede_rt.values.policy import REPLICAS_MAX
from stampede_rt.values.timeline import format_duration

ITEM_BYTES_MAX = 16 * 2**20
CONTENT_TYPE_BYTES_MAX = 255
ON_FULL = ("drop_oldest", "block", "reject")
ACKS = ("host", "disk", "replica")
LIMITS = ("max_age_nanos", "max_items", "max_bytes", "consumers")
# The values of fields that nobody stated before a limit was stated. content_type is not here: without a stated
# content_type the channel does not change the type of items.
IN_EFFECT_UNSTATED = {  # by field
    "max_bytes": 256 * 2**20,
    "on_full": "drop_oldest",
    "max_future_nanos": 10**9,
    "max_item_bytes": ITEM_BYTES_MAX,
    "replicas": 0,
    "ack": "host",
    "min_replicas": 1,
}
# The field that only the creation sets, because another value would change the spans of items that readers have seen.
FIXED = "overlap_nanos"
_RANGES = {  # by field: the least and the greatest value, and the text of this range
    "max_age_nanos": (1, 2**63 - 1, "more than 0"),
    "max_items": (1, 2**64 - 1, "at least 1"),
    "max_bytes": (1, 2**64 - 1, "at least 1"),
    "consumers": (1, 1024, "1 to 1024"),
    "max_age_unconsumed_nanos": (1, 2**63 - 1, "more than 0"),
    "max_future_nanos": (0, 2**63 - 1, "0 or more"),
    "overlap_nanos": (1, OVERLAP_NANOS_MAX, "more than 0 and at most 1 h"),
    "archive_nanos": (1, 2**63 - 1, "more than 0"),
    "archive_bytes": (2**20, 2**64 - 1, "at least 1048576 (1 MiB)"),
    "max_item_bytes": (1, ITEM_BYTES_MAX, f"1 to {ITEM_BYTES_MAX} bytes"),
    "replicas": (0, REPLICAS_MAX, f"0 to {REPLICAS_MAX}"),
    "min_replicas": (0, REPLICAS_MAX, f"0 to {REPLICAS_MAX}"),
}


def is_provisional(policy: Policy) -> bool:
    """Whether no limit (LIMITS) was stated so far. Such a channel takes over the first limits that a caller states."""
    return all(getattr(policy, name) is None for name in LIMITS)


def stated_settings(policy: Policy) -> dict[str, int | str]:
    """The stated fields of a policy, by name."""
    named = {field.name: getattr(policy, field.name) for field in fields(policy)}
    return {name: value for name, value in named.items() if value is not None}


def check_ranges(channel: str, policy: Policy) -> None:
    """Raises InvalidArgument if a stated field has a value that every channel refuses. `channel`: its name or id."""
    for name, (low, high, allowed) in _RANGES.items():
        value = getattr(policy, name)
        if value is not None and not low <= value <= high:
            raise _invalid(channel, name, out_of_range(name, value, allowed))
    if policy.on_full is not None and policy.on_full not in ON_FULL:
        raise _invalid(channel, "on_full", f"on_full is {policy.on_full!r}; it must be one of {', '.join(ON_FULL)}")
    if policy.ack is not None and policy.ack not in ACKS:
        raise _invalid(channel, "ack", f"ack is {policy.ack!r}; it must be one of {', '.join(ACKS)}")
    _check_content_type(channel, policy.content_type)


def out_of_range(field: str, value: int, allowed: str) -> str:
    """The error text for a field that is out of range. The text shows durations with units, as callers write them."""
    if field.endswith("_nanos"):
        return f"{field.removesuffix('_nanos')} is {format_duration(value)}; it must be {allowed}"
    return f"{field} is {value}; it must be {allowed}"


def check_policy(channel: str, policy: Policy) -> None:
    """Raises InvalidArgument if `policy` is not possible as the whole policy of `channel`."""
    check_ranges(channel, policy)
    if policy.on_full == "block" and policy.max_age_nanos is None and policy.consumers is None:
        text = 'on_full="block" waits for ever if nothing makes room; state max_age or consumers with it'
        raise _invalid(channel, "on_full", text)
    least, most = policy.max_age_nanos, policy.max_age_unconsumed_nanos
    if most is not None and (least is None or most < least):
        text = (
            "max_age_unconsumed keeps items longer than max_age for consumers that lag; state both, with "
            "max_age_unconsumed equal to max_age or greater"
        )
        raise _invalid(channel, "max_age_unconsumed_nanos", text)
    if policy.ack == "disk" and not policy.is_recorded:
        text = 'ack="disk" waits for the archive, and the channel has none; state archive or archive_bytes with it'
        raise _invalid(channel, "ack", text)
    _check_replicas(channel, policy)


def _check_replicas(channel: str, policy: Policy) -> None:
    replicas, waits_for_replicas = policy.replicas or 0, policy.ack == "replica"
    if waits_for_replicas and not replicas:
        text = 'ack="replica" waits for replicas, and the channel has none; state replicas of 1 or more with it'
        raise _invalid(channel, "ack", text)
    if replicas and policy.is_recorded:
        text = (
            "a channel with replicas cannot have an archive yet; leave out either replicas and ack, or archive and "
            "archive_bytes"
        )
        raise _invalid(channel, "replicas", text)
    if waits_for_replicas and policy.min_replicas is not None and policy.min_replicas > replicas:
        text = f"min_replicas is {policy.min_replicas}, and replicas is {replicas}; state {replicas} or less"
        raise _invalid(channel, "min_replicas", text)


def check_fixed(channel: str, held: Policy, changes: Policy) -> None:
    """Raises InvalidArgument if `changes` changes a field that is fixed at creation."""
    before, wanted = getattr(held, FIXED), getattr(changes, FIXED)
    if wanted not in (None, before):
        name = FIXED.removesuffix("_nanos")
        raise _invalid(
            channel, FIXED, f"{name} is fixed when a channel is created; delete the channel and create it again"
        )


def _check_content_type(channel: str, content_type: str | None) -> None:
    if content_type is None:
        return
    if len(content_type.encode()) > CONTENT_TYPE_BYTES_MAX or not content_type.isprintable():
        text = f"content_type must be a MIME type of {CONTENT_TYPE_BYTES_MAX} printable bytes at most"
        raise _invalid(channel, "content_type", text)


def _invalid(channel: str, field: str, text: str) -> InvalidArgument:
    return InvalidArgument(f"channel {channel}: {text}", metadata={"channel": channel, "field": field})


def agree(channel: str, held: Policy, requested: Policy) -> Policy:
    """The policy of `channel` after an open with the policy `requested`.

    Raises ChannelExists, which names the field in conflict.

    The caller may only repeat a field that was stated before, or leave it out. While the channel is provisional
    (`is_provisional`), it takes over each field of `requested` that was never stated. Later `requested`
    must have the value in effect, because another value would collect items of other callers without their knowledge.
    The channel takes over content_type later, too.
    """
    for name, value in stated_settings(requested).items():
        before = getattr(held, name)
        if before is None and name != FIXED and (is_provisional(held) or name == "content_type"):
            continue
        in_effect = IN_EFFECT_UNSTATED.get(name) if before is None else before
        if value != in_effect:
            raise _contradiction(channel, name, before, in_effect, value)
    merged = merge(held, requested)
    if merged != held:
        check_policy(channel, merged)
    return merged


def _contradiction(channel: str, field: str, before: object, in_effect: object, value: object) -> ChannelExists:
    name = field.removesuffix("_nanos")
    held = _as_written(field, in_effect)
    change = "" if field == FIXED else ", or change it for everybody with configure()"
    was = f"{name} {held}" if before is not None else f"{name} left out (in effect: {held})"
    return ChannelExists(
        f"channel {channel} exists with {was}, and the request states {name} {_as_written(field, value)}; leave {name} "
        f"out to take the channel as it is{change}",
        metadata={"channel": channel, "field": field, "held": str(in_effect), "asked": str(value)},
    )


def _as_written(field: str, value: object) -> str:
    """A value in the form in which callers write it."""
    if value is None:
        return "no limit"
    return format_duration(value) if field.endswith("_nanos") and isinstance(value, int) else str(value)


def merge(held: Policy, changes: Policy) -> Policy:
    """`held` with the stated fields of `changes`."""
    return replace(held, **stated_settings(changes))  # type: ignore[arg-type]  # each value comes from the field of that name
