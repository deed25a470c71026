"""Names of topics: which match a glob, and how they become names of channels. Pure."""

from __future__ import annotations

import re
from functools import lru_cache

NAME_CHARACTERS_MAX = 128
_FORBIDDEN = re.compile(r"[^A-Za-z0-9._/-]")


@lru_cache(256)
def _pattern(glob: str) -> re.Pattern[str]:
    parts = (".*" if one == "*" else "." if one == "?" else re.escape(one) for one in re.sub(r"\*+", "*", glob))
    return re.compile("".join(parts), re.DOTALL)


def matches(glob: str, name: str) -> bool:
    """Whether a name matches a glob: "*" stands for any characters, "?" for one."""
    return _pattern(glob).fullmatch(name) is not None


def channel_name(topic: str, prefix: str = "") -> str:
    """Return the name of a channel for a topic, such as "imu/data" for "/imu/data".

    Each character that no channel's name has becomes "_". A long name loses its beginning.
    """
    name = _FORBIDDEN.sub("_", topic).lstrip("./_-") or "unnamed"
    return prefix + name[-max(1, NAME_CHARACTERS_MAX - len(prefix)) :].lstrip("./_-")
