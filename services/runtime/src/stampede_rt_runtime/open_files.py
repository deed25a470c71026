"""How many files and connections this process may hold open. POSIX: getrlimit, RLIMIT_NOFILE."""

from __future__ import annotations

import contextlib
import resource

CONNECTIONS_MAX = 65_536
_OWN_FILES = 256  # for databases, logs, and the connections that the process opens itself


def raise_limit() -> None:
    """Allow this process as many open files as the system lets it have: 1024, a usual default, are soon used up."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(ValueError, OSError):  # some systems refuse "unlimited": then the limit stays
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def connections_max() -> int:
    """How many connections a server may accept, so that its own files can still be opened."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files == resource.RLIM_INFINITY:
        return CONNECTIONS_MAX
    return min(CONNECTIONS_MAX, max(files // 2, files - _OWN_FILES))
