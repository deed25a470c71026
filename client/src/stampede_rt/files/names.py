"""Names of topics: whether they match a glob, and how they become names of channels. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from fnmatch import translate
from functools import lru_cache

NAME_CHARACTERS_MAX = 128
_FORBIDDEN = re.compile(r"[^A-Za-z0-9._/-]")


@lru_cache(256)
def _pattern(glob: str) -> re.Pattern[str]:
    return re.compile(translate(glob.replace("[", "[[]")))  # `translate` writes stars that do not backtrack


def matches(glob: str, name: str) -> bool:
    """Whether a name matches a glob: "*" matches any characters, "?" one."""
    return _pattern(glob).match(name) is not None


def channel_name(topic: str, prefix: str = "") -> str:
    """Return the name of a channel for a topic, such as "imu/data" for "/imu/data".

    Each character that names of channels cannot have becomes "_". A long name loses its beginning.
    """
    name = _FORBIDDEN.sub("_", topic).lstrip("./_-") or "unnamed"
    return prefix + name[-max(1, NAME_CHARACTERS_MAX - len(prefix)) :].lstrip("./_-")


def matches_any(globs: Iterable[str] | None) -> Callable[[str], bool]:
    """Return a function that is true for a name that matches one of the globs. None: it is true for all names."""
    if globs is None:
        return lambda name: True
    many = tuple(globs)
    return lambda name: any(matches(glob, name) for glob in many)
