"""Checked patterns over names, as callers send them. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable

from stampede_rt_runtime import globs
from stampede_rt_supernode.core.validation import check_glob


def matcher(glob: str) -> Callable[[str], bool]:
    """Returns a function that says whether a name matches `glob`. Every name matches an empty `glob`.

    The function takes time in proportion to the name's length times the number of stars, at most. Raises
    InvalidArgument for an invalid pattern.
    """
    check_glob(glob)
    return globs.matcher(glob)


def fixed_prefix(glob: str) -> str:
    """The text with which every matching name begins."""
    return re.split(r"[*?]", glob, maxsplit=1)[0]
