"""The entries of the log, and their kinds. Pure."""

from __future__ import annotations

from typing import NamedTuple

# The kinds of entries: the first byte of an entry's command. The library has entries of its own for changes of members,
# which are pickles and also of kind 2. The library is configured to neither make nor read them.
COMMAND, NO_OP, CONFIGURATION = 0, 1, 2


class Entry(NamedTuple):
    """One position of the log. The order of the fields is the library's, which indexes entries by number."""

    command: bytes
    log_index: int
    term: int
