"""Gives a service memory in pages of 2 MiB, if the kernel leaves the choice to the program (decision 0312).

The kernel provides each page at its first use. With pages of 4 KiB this takes longer than to copy the bytes of a new
item. glibc asks for huge pages if a variable says so, and reads this variable only at the start of a program.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence

VARIABLE = "GLIBC_TUNABLES"
_TUNABLE = "glibc.malloc.hugetlb"
_FIRST_GLIBC = (2, 35)
_AGAIN = "stampede_started_again"  # the name of an option -X of Python
_MODES = "/sys/kernel/mm/transparent_hugepage/enabled"


def tunables_with_huge_pages(tunables: str, glibc: str, modes: str) -> str | None:
    """The value of VARIABLE for huge pages; None if it should stay as it is. Pure.

    `tunables`: the present value. An operator's own choice about huge pages stays. `glibc`: the C library and its
    version, such as "glibc 2.36". `modes`: the kernel's modes of huge pages, with brackets around the present one.
    """
    if _TUNABLE in tunables or "[madvise]" not in modes or _version(glibc) < _FIRST_GLIBC:
        return None
    return ":".join(filter(None, (tunables, f"{_TUNABLE}=1")))


def _version(glibc: str) -> tuple[int, ...]:
    name, _, version = glibc.partition(" ")
    return tuple(int(one) for one in version.split(".") if one.isdigit()) if name == "glibc" else ()


def start_again_with_huge_pages(command: str, words: Sequence[str]) -> None:
    """Replace this program by itself, with the variable set. Does nothing if the program would gain nothing.

    Call it before the program loads much or starts anything. Process id, standard streams and parent stay. If the
    process's command line does not end with `command` and `words`, the caller runs inside another program, and this
    function does nothing.

    The second start knows by an option of Python that it is the second. glibc removes the variable from a program with
    special rights, such as file capabilities. Such a program continues without huge pages.
    """
    if _AGAIN in sys._xoptions or not sys.executable or sys.orig_argv[-len(words) - 1 :] != [command, *words]:
        return
    with contextlib.suppress(OSError, ValueError):  # another system or C library, or the program's file has gone
        with open(_MODES) as file:
            modes = file.read()
        glibc = os.confstr("CS_GNU_LIBC_VERSION") or ""
        value = tunables_with_huge_pages(os.environ.get(VARIABLE, ""), glibc, modes)
        if value is not None:
            command_line = [sys.executable, "-X", _AGAIN, *sys.orig_argv[1:]]
            os.execve(sys.executable, command_line, {**os.environ, VARIABLE: value})


def has_huge_pages() -> bool:
    """Whether glibc asks the kernel for huge pages in this process."""
    return f"{_TUNABLE}=1" in os.environ.get(VARIABLE, "")
