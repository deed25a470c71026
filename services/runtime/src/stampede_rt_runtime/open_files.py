"""The number of files and connections that this process may hold open. POSIX: getrlimit, RLIMIT_NOFILE."""

from __future__ import annotations

import contextlib
import resource

CONNECTIONS_MAX = 65_536
_OWN_FILES = 256  # for databases, logs, and outgoing connections


def raise_limit() -> None:
    """Raise this process's limit of open files to the system's maximum. A usual default, 1024, is soon used up."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(ValueError, OSError):  # some systems refuse "unlimited"; then the limit stays
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def connections_max() -> int:
    """The number of connections that a server may accept, so that enough files are left for the process itself."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files == resource.RLIM_INFINITY:
        return CONNECTIONS_MAX
    return min(CONNECTIONS_MAX, max(files // 2, files - _OWN_FILES))
