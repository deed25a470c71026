"""Text for terminals: a check of payloads for `--raw`, and tables that fit the width of the terminal."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence
from itertools import zip_longest

from stampede_rt.errors import InvalidArgument

GAP = "  "  # between two columns
CELL_CHARACTERS_MIN = 8  # no column becomes narrower


def check_raw_output(payload: bytes) -> None:
    """Raise InvalidArgument if standard output is a terminal and `payload` could give commands to the terminal."""
    if not sys.stdout.isatty():
        return
    try:
        text = payload.decode()
    except UnicodeDecodeError:
        text = "\0"
    if not text.replace("\n", "").replace("\t", "").isprintable():
        raise InvalidArgument(
            "--raw: this payload is not plain text and could give the terminal commands; write it to a file or a "
            "program, as in `... --raw > FILE`"
        )


def columns_max() -> int | None:
    """Return the greatest number of characters in a line; None if standard output is not a terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def table_lines(rows: Sequence[Sequence[str]], right: Sequence[bool], width_max: int | None) -> list[str]:
    """Return `rows` as lines of aligned columns. `right` says for each column whether it is aligned to the right.

    The function wraps the widest text columns until a line has at most `width_max` characters. If `width_max` is None,
    it wraps no column. If the columns do not fit even so, each row becomes lines of a head and a value.
    """
    widths = [max(len(row[i]) for row in rows) for i in range(len(right))]
    if width_max is not None:
        gaps = len(GAP) * (len(widths) - 1)
        widths = _fitted(widths, right, width_max - gaps)
        if sum(widths) + gaps > width_max and len(widths) > 1:
            return _records(rows, width_max)
    lines = []
    for row in rows:
        cells = [_wrapped(cell, width) for cell, width in zip(row, widths, strict=True)]
        for parts in zip_longest(*cells, fillvalue=""):
            placed = zip(parts, widths, right, strict=True)
            lines.append(GAP.join(c.rjust(w) if r else c.ljust(w) for c, w, r in placed).rstrip())
    return lines


def _records(rows: Sequence[Sequence[str]], width_max: int) -> list[str]:
    """Return each row as lines of a head and a value, with an empty line between two rows. `rows` begin with heads."""
    heads, *others = rows
    width = min(max(map(len, heads)), max(CELL_CHARACTERS_MIN, width_max // 2))
    beside = max(CELL_CHARACTERS_MIN, width_max - width - len(GAP))
    lines: list[str] = []
    for row in others:
        lines += [""] if lines else []
        for head, cell in zip(heads, row, strict=True):
            parts = zip_longest(_wrapped(head, width), _wrapped(cell, beside), fillvalue="")
            lines += [f"{name:<{width}}{GAP}{part}".rstrip() for name, part in parts]
    return lines


def _fitted(widths: Sequence[int], right: Sequence[bool], sum_max: int) -> list[int]:
    """Return `widths`, with the widest text columns narrowed until the sum of all widths is at most `sum_max`.

    The function makes no column narrower than CELL_CHARACTERS_MIN. The sum may therefore stay above `sum_max`.
    """
    fitted = list(widths)
    while sum(fitted) > sum_max:
        widest = max((i for i, is_right in enumerate(right) if not is_right), key=lambda i: fitted[i], default=None)
        if widest is None or fitted[widest] <= CELL_CHARACTERS_MIN:
            break
        fitted[widest] -= 1
    return fitted


def _wrapped(cell: str, width: int) -> list[str]:
    return textwrap.wrap(cell, width, break_on_hyphens=False) or [""] if len(cell) > width else [cell]
