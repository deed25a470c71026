"""Patterns over names: `*` matches any run of characters, `?` one character. Pure.

Callers send patterns. The time of a match is at most in proportion to the name's length times the number of stars.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fnmatch import translate
from functools import lru_cache

_KEPT_MAX = 4096


@lru_cache(_KEPT_MAX)
def matcher(glob: str) -> Callable[[str], bool]:
    """A function that returns whether a name matches `glob`.

    Every name matches an empty `glob`. Brackets match themselves.
    """
    beginning = glob.removesuffix("*")
    # most patterns have only a star at the end; an expression takes 0.1 ms to compile
    if not re.search(r"[*?]", beginning):
        return _beginning_with(beginning) if glob == "" or beginning != glob else glob.__eq__
    pattern = re.compile(translate(glob.replace("[", "[[]")))
    return lambda name: pattern.match(name) is not None


def _beginning_with(prefix: str) -> Callable[[str], bool]:
    return lambda name: name.startswith(prefix)
