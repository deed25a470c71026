"""The exit statuses of all commands. Pure. docs/command-line.md and the man page explain the same statuses."""

from __future__ import annotations

FAILED = 1
MISUSED = 2
NOTHING = INCOMPLETE = 3
INTERRUPTED = 130

EXIT_STATUSES = {
    0: "The command succeeded.",
    FAILED: "The command failed, or `stampede doctor` or `stampede supernode status` found a fault.",
    MISUSED: "The usage was wrong: an option, a name, a time or a payload is not valid. The command changed nothing.",
    NOTHING: "There is nothing to return, or something is missing.",
    INTERRUPTED: "Ctrl-C ended the command.",
}
"""Each status, with the first sentence that explains it."""
