"""Checks of the policies that callers state (paper, section 3.4). Pure."""

from __future__ import annotations

import operator
import re
from typing import get_args

from stampede_rt.errors import InvalidArgument, InvalidName
from stampede_rt.values.model import Ack, OnFull, Policy
from stampede_rt.values.timeline import DurationLike, parse_duration

NAME_GRAMMAR = r"[A-Za-z0-9][A-Za-z0-9._/-]{0,127}"
"""The pattern of the names of channels, groups, queues, peers and hosts. Upper and lower case differ."""
_NAME = re.compile(NAME_GRAMMAR)
MAX_BYTES_MIN = 64
"""The smallest `max_bytes` of a policy: an item without payload counts as this many bytes."""
FOREVER_NANOS = 2**63 - 1
"""The value of `Policy.archive_nanos` for an archive that keeps its items for ever."""
ARCHIVE_BYTES_MIN = 2**20
MAX_FUTURE_DEFAULT_NANOS = 10**9
HOST_MEMORY_BYTES_MIN = 2**20
_SIZE_UNITS = {
    "": 1,
    "KiB": 2**10,
    "MiB": 2**20,
    "GiB": 2**30,
    "TiB": 2**40,
    "kB": 10**3,
    "MB": 10**6,
    "GB": 10**9,
    "TB": 10**12,
}
_SIZE = re.compile(r"([0-9]+(?:\.[0-9]+)?) ?(" + "|".join(_SIZE_UNITS) + ")")
ON_FULL: tuple[OnFull, ...] = get_args(OnFull)
ACKS: tuple[Ack, ...] = get_args(Ack)
REPLICAS_MAX = 4


def parse_name(name: str, what: str = "channel") -> str:
    """Return `name`. Raises InvalidName unless it matches NAME_GRAMMAR. `what` names the kind of thing in the error."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise InvalidName(
            f"the {what} name {name!r} is not allowed; use 1 to 128 of A-Z, a-z, 0-9, '.', '_', '/', '-', beginning "
            "with a letter or digit"
        )
    return name


def parse_policy(
    *,
    max_age: DurationLike | None = None,
    max_items: int | None = None,
    max_bytes: int | None = None,
    consumers: int | None = None,
    on_full: OnFull | None = None,
    max_future: DurationLike | None = None,
    content_type: str | None = None,
    max_age_unconsumed: DurationLike | None = None,
    overlap: DurationLike | None = None,
    archive: DurationLike | None = None,
    archive_bytes: int | str | None = None,
    replicas: int | None = None,
    ack: Ack | None = None,
    min_replicas: int | None = None,
) -> Policy:
    """Return the policy that the arguments state. An argument that is None is not stated.

    Raises InvalidArgument, which names the wrong argument.
    """
    if on_full is not None and on_full not in ON_FULL:
        raise InvalidArgument(f"on_full is {on_full!r}; write one of {', '.join(map(repr, ON_FULL))}")
    return Policy(
        max_age_nanos=duration_of("max_age", max_age, least=1),
        max_items=count_of("max_items", max_items),
        max_bytes=max_bytes_of(max_bytes),
        consumers=count_of("consumers", consumers, below=2**32),
        on_full=on_full,
        max_future_nanos=duration_of("max_future", max_future, least=0),
        content_type=content_type_of(content_type),
        max_age_unconsumed_nanos=duration_of("max_age_unconsumed", max_age_unconsumed, least=1),
        overlap_nanos=duration_of("overlap", overlap, least=1),
        archive_nanos=archive_nanos_of(archive),
        archive_bytes=archive_bytes_of(archive_bytes),
        replicas=replicas_of("replicas", replicas),
        ack=ack_of(ack),
        min_replicas=replicas_of("min_replicas", min_replicas),
    )


def ack_of(value: Ack | None) -> Ack | None:
    """Return `value`. Raises InvalidArgument unless it is None or one of ACKS."""
    if value is not None and value not in ACKS:
        raise InvalidArgument(f"ack is {value!r}; write one of {', '.join(map(repr, ACKS))}")
    return value


def replicas_of(what: str, value: int | None) -> int | None:
    """Return `value`. Raises InvalidArgument, which names `what`, unless it is None or 0 to REPLICAS_MAX."""
    if value is None:
        return None
    count = whole_number_of(what, value)
    if not 0 <= count <= REPLICAS_MAX:
        raise InvalidArgument(f"{what} is {value!r}; it must be 0 to {REPLICAS_MAX}")
    return count


def archive_nanos_of(value: DurationLike | None) -> int | None:
    """Return `value` in nanoseconds, FOREVER_NANOS for "forever"; None if it is None. Raises InvalidArgument."""
    return FOREVER_NANOS if value == "forever" else duration_of("archive", value, least=1)


def archive_bytes_of(value: int | str | None) -> int | None:
    """Return `value`, a number of bytes or a text such as "200GiB"; None if it is None. Raises InvalidArgument."""
    count = None if value is None else size_of("archive_bytes", value)
    if count is not None and count < ARCHIVE_BYTES_MIN:
        raise InvalidArgument(f"archive_bytes is {value!r}; it must be {ARCHIVE_BYTES_MIN} (1 MiB) or more")
    return count


def memory_of(what: str, value: int | str) -> int:
    """Return `value` in bytes, the memory of a host. Raises InvalidArgument, which names `what`."""
    count = size_of(what, value)
    if count < HOST_MEMORY_BYTES_MIN:
        raise InvalidArgument(f"{what} is {value!r}; it must be {HOST_MEMORY_BYTES_MIN} (1 MiB) or more")
    return count


def size_of(what: str, value: int | str) -> int:
    """Return `value`, a number of bytes or a text such as "200GiB", in bytes. Raises InvalidArgument."""
    if isinstance(value, str):
        found = _SIZE.fullmatch(value.strip())
        if found is None:
            raise InvalidArgument(f'{what} is {value!r}; write a number of bytes, or a size such as "200GiB"')
        value = int(float(found[1]) * _SIZE_UNITS[found[2]])
    count = count_of(what, value)
    assert count is not None, "count_of returns None only for None"
    return count


def content_type_of(value: str | None) -> str | None:
    """Return `value`. Raises InvalidArgument unless it is None or ASCII text of 1 to 255 characters."""
    if value is not None and not (isinstance(value, str) and value.isascii() and 0 < len(value) <= 255):
        raise InvalidArgument(f"content_type is {value!r}; write a MIME type of 1 to 255 ASCII characters")
    return value


def duration_of(what: str, value: DurationLike | None, *, least: int) -> int | None:
    """Return `value` in nanoseconds; None if it is None. Raises InvalidArgument, which names `what`.

    `least` is 1 if the duration must be more than 0, and 0 if it may be 0.
    """
    if value is None:
        return None
    nanos = parse_duration(value, what)
    if nanos < least:
        raise InvalidArgument(f"{what} is {value!r}; it must be {'more than 0' if least else '0 or more'}")
    return nanos


def count_of(what: str, value: int | None, *, below: int = 2**63) -> int | None:
    """Return `value`, a whole number of 1 or more and less than `below`, a power of two; None if it is None.

    Raises InvalidArgument, which names `what`.
    """
    if value is None:
        return None
    count = whole_number_of(what, value)
    if not 1 <= count < below:
        raise InvalidArgument(f"{what} is {value!r}; it must be 1 or more, and below 2**{below.bit_length() - 1}")
    return count


def max_bytes_of(value: int | None) -> int | None:
    """Return `value`; None if it is None. Raises InvalidArgument unless it is a number of MAX_BYTES_MIN or more."""
    found = count_of("max_bytes", value)
    if found is not None and found < MAX_BYTES_MIN:
        raise InvalidArgument(
            f"max_bytes is {value!r}; it must be {MAX_BYTES_MIN} or more, because an item counts as its payload and "
            f"{MAX_BYTES_MIN} bytes"
        )
    return found


def whole_number_of(what: str, value: int) -> int:
    """Return `value` as an int. Refuses True and False. Raises InvalidArgument, which names `what`."""
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise InvalidArgument(f"{what} is {value!r}; it must be a whole number")
    return operator.index(value)


def flag_of(what: str, value: bool) -> bool:
    """Return `value`. Raises InvalidArgument unless it is True or False, because Python takes the text "no" as true."""
    if not isinstance(value, bool):
        raise InvalidArgument(f"{what} is {value!r}; write True or False")
    return value
