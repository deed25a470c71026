"""Patterns over channel names: `*` stands for any run of characters, `?` for one. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable
from fnmatch import translate

from stampede_rt_supernode.core.validation import check_glob


def matcher(glob: str) -> Callable[[str], bool]:
    """Whether a name matches `glob`; empty: every name does. Time is linear in the name for each star.

    Raises InvalidArgument.
    """
    check_glob(glob)  # leaves no bracket, whose meaning fnmatch would extend to sets of characters
    if glob in ("", "*"):
        return lambda name: True
    pattern = re.compile(translate(glob), re.ASCII)
    return lambda name: pattern.match(name) is not None


def fixed_prefix(glob: str) -> str:
    """What every matching name begins with."""
    return re.split(r"[*?]", glob, maxsplit=1)[0]
