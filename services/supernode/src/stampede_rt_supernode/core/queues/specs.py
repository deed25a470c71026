"""Checks which policies of a queue are possible, and whether two of them agree (paper, section 3.5). Pure.

The rules are the same as for channels. A field that is None was never stated. A stated value stays in effect until an
update changes it. A later open may repeat the value or leave it out.
"""

from __future__ import annotations

from dataclasses import fields, replace

from stampede_rt.errors import InvalidArgument, StampedeError, error_for
from stampede_rt.values.policy import REPLICAS_MAX
from stampede_rt.values.timeline import format_duration
from stampede_rt_supernode.core.channels.policies import CONTENT_TYPE_BYTES_MAX, ITEM_BYTES_MAX, out_of_range
from stampede_rt_supernode.core.records import QueueSpec
from stampede_rt_supernode.core.validation import check_id

ON_FULL = ("block", "reject", "drop_oldest")
LIMITS = ("max_items", "max_bytes")
# The policy of a mailbox for which the peer states none.
MAILBOX_UNSTATED = QueueSpec(max_items=1024)
# The values of unstated fields. content_type is not here: without it the queue does not change the type of messages.
IN_EFFECT_UNSTATED = {
    "max_bytes": 256 * 2**20,
    "on_full": "block",
    "copies": 1,
    "lease_nanos": 30 * 10**9,
    "max_item_bytes": ITEM_BYTES_MAX,
    "replicas": 0,
    "ack": "host",
    "min_replicas": 1,
}
_RANGES = {  # by field: the least and the greatest value, and the text of this range
    "max_items": (1, 2**64 - 1, "at least 1"),
    "max_bytes": (1, 2**64 - 1, "at least 1"),
    "copies": (1, 2**32 - 1, "at least 1"),
    "lease_nanos": (1, 2**63 - 1, "more than 0"),
    "max_deliveries": (1, 2**32 - 1, "at least 1"),
    "max_item_bytes": (1, ITEM_BYTES_MAX, f"1 to {ITEM_BYTES_MAX} bytes"),
    "replicas": (0, REPLICAS_MAX, f"0 to {REPLICAS_MAX}"),
    "min_replicas": (0, REPLICAS_MAX, f"0 to {REPLICAS_MAX}"),
}


def check_queue_spec(queue: str, spec: QueueSpec) -> None:
    """Raises InvalidArgument if a stated field has a value that every queue refuses. `queue`: its name or id."""
    for name, (low, high, allowed) in _RANGES.items():
        value = getattr(spec, name)
        if value is not None and not low <= value <= high:
            raise _invalid(queue, name, out_of_range(name, value, allowed))
    if spec.on_full is not None and spec.on_full not in ON_FULL:
        raise _invalid(queue, "on_full", f"on_full is {spec.on_full!r}; it must be one of {', '.join(ON_FULL)}")
    if spec.dead_letter_queue_id is not None:
        check_id(spec.dead_letter_queue_id, "dead_letter_queue_id")
    _check_content_type(queue, spec.content_type)


def check_replicas(queue: str, spec: QueueSpec) -> None:
    """Raises InvalidArgument unless the replicas of the whole policy `spec` agree with its ack."""
    replicas, waits_for_replicas = spec.replicas or 0, spec.ack == "replica"
    if waits_for_replicas and not replicas:
        text = 'ack="replica" waits for replicas, and the queue has none; state replicas of 1 or more with it'
        raise _invalid(queue, "ack", text)
    if replicas and not waits_for_replicas:
        text = 'a replica takes over without a loss only if puts wait for it; state ack="replica" with replicas'
        raise _invalid(queue, "replicas", text)
    if waits_for_replicas and spec.min_replicas is not None and spec.min_replicas > replicas:
        text = f"min_replicas is {spec.min_replicas}, and replicas is {replicas}; state {replicas} or less"
        raise _invalid(queue, "min_replicas", text)


def _check_content_type(queue: str, content_type: str | None) -> None:
    if content_type is None:
        return
    if len(content_type.encode()) > CONTENT_TYPE_BYTES_MAX or not content_type.isprintable():
        text = f"content_type must be a MIME type of {CONTENT_TYPE_BYTES_MAX} printable bytes at most"
        raise _invalid(queue, "content_type", text)


def _invalid(queue: str, field: str, text: str) -> InvalidArgument:
    return InvalidArgument(f"queue {queue}: {text}", metadata={"queue": queue, "field": field})


def stated_settings(spec: QueueSpec) -> dict[str, int | str | bytes]:
    """The stated fields of a policy, by name."""
    named = {field.name: getattr(spec, field.name) for field in fields(spec)}
    return {name: value for name, value in named.items() if value is not None}


def merge(held: QueueSpec, changes: QueueSpec) -> QueueSpec:
    """`held` with the stated fields of `changes`."""
    return replace(held, **stated_settings(changes))  # type: ignore[arg-type]  # each value comes from the field of that name


def agree(queue: str, held: QueueSpec, requested: QueueSpec) -> QueueSpec:
    """The policy of `queue` after an open with the policy `requested`.

    Raises QUEUE_EXISTS, which names the field in conflict.

    The caller may only repeat a field that was stated before, or leave it out. While no limit (LIMITS) was stated, the
    queue takes over each field of `requested` that was never stated. Later, `requested` must have the value in
    effect, because another value would affect other producers and takers.
    """
    provisional = all(getattr(held, name) is None for name in LIMITS)
    for name, value in stated_settings(requested).items():
        before = getattr(held, name)
        if before is None and (provisional or name == "content_type"):
            continue
        in_effect = IN_EFFECT_UNSTATED.get(name) if before is None else before
        if value != in_effect:
            raise _contradiction(queue, name, before, in_effect, value)
    return merge(held, requested)


def _contradiction(queue: str, field: str, before: object, in_effect: object, value: object) -> StampedeError:
    name = field.removesuffix("_nanos")
    held = _as_written(field, in_effect)
    was = f"{name} {held}" if before is not None else f"{name} left out (in effect: {held})"
    return error_for(
        "QUEUE_EXISTS",
        f"queue {queue} exists with {was}, and the request states {name} {_as_written(field, value)}; leave {name} "
        "out to take the queue as it is, or change it for everybody with configure()",
        {"queue": queue, "field": field, "held": held, "asked": _as_written(field, value)},
    )


def _as_written(field: str, value: object) -> str:
    """A value in the form in which callers write it."""
    if value is None:
        return "none"
    if isinstance(value, bytes):
        return value.hex()
    return format_duration(value) if field.endswith("_nanos") and isinstance(value, int) else str(value)
