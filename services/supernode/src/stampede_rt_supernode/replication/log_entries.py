"""The entries of the log, and their kinds. Pure."""

from __future__ import annotations

from typing import NamedTuple

# The kinds of entries: the first byte of an entry's command. The library has entries of its own for changes of members,
# which are pickles and also of kind 2. The library is configured to neither make nor read them.
COMMAND, NO_OP, CONFIGURATION = 0, 1, 2


class Entry(NamedTuple):
    """One position of the log. The first byte of `command` is the kind of the entry.

    The library reads the fields by their numbers, so their order must stay.
    """

    command: bytes
    log_index: int
    term: int
