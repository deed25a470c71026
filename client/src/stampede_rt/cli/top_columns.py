"""The columns of `stampede top` that fit into a terminal. Pure."""

from __future__ import annotations

COLUMN_NAMES = ("HOST", "ITEMS/S", "IN/S", "OUT/S", "AGE", "LAG", "HELD", "READERS", "REFUSED/S", "DROPS/S")
"""All columns but the channel's, in the order of the screen."""
WIDTHS = {
    "ITEMS/S": 9, "AGE": 9, "IN/S": 10, "LAG": 6, "OUT/S": 10, "DROPS/S": 8, "HELD": 8, "READERS": 7, "REFUSED/S": 9,
    "HOST": 12,
}  # fmt: skip
"""The width that each column needs for most values, the most important column first."""
GAP = 2  # between two columns
CHANNEL_MIN, CHANNEL_MAX = 12, 32  # the characters that the other columns leave for long names


def fitting_columns(terminal: int, longest_name: int) -> tuple[str, ...]:
    """Return the heads that fit beside the names of the channels, in the order of the screen.

    `terminal` and `longest_name` are numbers of characters. A narrow terminal loses the least important columns first.
    The names get at most half of it.
    """
    left = terminal - max(CHANNEL_MIN, min(longest_name, CHANNEL_MAX, terminal // 2))
    fitting = set()
    for head, width in WIDTHS.items():
        left -= GAP + width
        if left < 0:
            break
        fitting.add(head)
    return tuple(head for head in COLUMN_NAMES if head in fitting)
