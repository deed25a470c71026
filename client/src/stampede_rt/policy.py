"""What callers say of a channel's set-up, checked (paper, section 3.4). Pure."""

from __future__ import annotations

import operator
import re

from stampede_rt.errors import InvalidArgument, InvalidName
from stampede_rt.model import Policy
from stampede_rt.timeline import DurationLike, parse_duration

_NAME = re.compile(r"[a-z0-9][a-z0-9._/-]{0,127}")
ON_FULL = ("drop_oldest", "block", "reject")


def parse_name(name: str, what: str = "channel") -> str:
    """`name` as it is. Raises InvalidName."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise InvalidName(
            f"the {what} name {name!r} is not allowed; use 1 to 128 of a-z, 0-9, '.', '_', '/', '-', beginning with a "
            "letter or digit"
        )
    return name


def parse_policy(
    *,
    max_age: DurationLike | None = None,
    max_items: int | None = None,
    max_bytes: int | None = None,
    consumers: int | None = None,
    on_full: str | None = None,
    max_future: DurationLike | None = None,
    content_type: str | None = None,
) -> Policy:
    """The stated set-up; None stands for not stated. Raises InvalidArgument, naming the argument."""
    if on_full is not None and on_full not in ON_FULL:
        raise InvalidArgument(f"on_full is {on_full!r}; write one of {', '.join(map(repr, ON_FULL))}")
    if content_type is not None and not (content_type.isascii() and 0 < len(content_type) <= 255):
        raise InvalidArgument(f"content_type is {content_type!r}; write a MIME type of 255 characters at most")
    return Policy(
        max_age_nanos=_duration("max_age", max_age, least=1),
        max_items=_count("max_items", max_items),
        max_bytes=_count("max_bytes", max_bytes),
        consumers=_count("consumers", consumers),
        on_full=on_full,
        max_future_nanos=_duration("max_future", max_future, least=0),
        content_type=content_type,
    )


def _duration(what: str, value: DurationLike | None, *, least: int) -> int | None:
    if value is None:
        return None
    nanos = parse_duration(value, what)
    if nanos < least:
        raise InvalidArgument(f"{what} is {value!r}; it must be {'more than 0' if least else '0 or more'}")
    return nanos


def _count(what: str, value: int | None) -> int | None:
    if value is None:
        return None
    try:
        count = operator.index(value)
    except TypeError:
        raise InvalidArgument(f"{what} is {value!r}; it must be a whole number") from None
    if isinstance(value, bool) or not 1 <= count < 2**63:
        raise InvalidArgument(f"{what} is {value!r}; it must be 1 or more")
    return count
