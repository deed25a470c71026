"""Patterns over names: `*` stands for any run of characters, `?` for one. Pure.

Callers send patterns, so a match takes a time linear in the name for each star, whatever they send.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fnmatch import translate
from functools import lru_cache

_KEPT_MAX = 4096


@lru_cache(_KEPT_MAX)
def matcher(glob: str) -> Callable[[str], bool]:
    """Whether a name matches `glob`; empty: every name does. A bracket stands for itself."""
    beginning = glob.removesuffix("*")
    if not re.search(r"[*?]", beginning):  # most patterns are; an expression takes 0.1 ms to compile
        return _beginning_with(beginning) if glob == "" or beginning != glob else glob.__eq__
    pattern = re.compile(translate(glob.replace("[", "[[]")))
    return lambda name: pattern.match(name) is not None


def _beginning_with(prefix: str) -> Callable[[str], bool]:
    return lambda name: name.startswith(prefix)
