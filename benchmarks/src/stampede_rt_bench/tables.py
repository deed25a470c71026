"""Tables in plain text, one figure a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from stampede_rt_bench.measuring import Spread


@dataclass
class Table:
    """Columns and rows of text; `notes` are sentences below."""

    columns: Sequence[str]
    rows: list[Sequence[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def render(self) -> str:
        """The table, its columns aligned to the right."""
        lines = [self.columns, *self.rows]
        widths = [max(len(line[place]) for line in lines) for place in range(len(self.columns))]
        text = ["  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
        return "\n".join(text + self.notes)

    def markdown(self) -> str:
        """The table as Markdown, its notes below."""
        lines = [self.columns, ["---", *["---:"] * (len(self.columns) - 1)], *self.rows]
        text = ["| " + " | ".join(line) + " |" for line in lines]
        return "\n".join(text + (["", *self.notes] if self.notes else []))

    def print(self) -> None:
        """On standard output."""
        print(self.render(), flush=True)


def spread(value: Spread, digits: int = 1) -> str:
    """`12.3 (12.0 to 14.1)`."""
    return f"{value.median:,.{digits}f} ({value.least:,.{digits}f} to {value.most:,.{digits}f})"
