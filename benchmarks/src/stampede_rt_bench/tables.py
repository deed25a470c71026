"""Tables in plain text and in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from stampede_rt_bench.measuring import Spread


@dataclass
class Table:
    """Columns and rows of text. `notes` are sentences below the table."""

    columns: Sequence[str]
    rows: list[Sequence[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def render(self) -> str:
        """Return the table as text, with all columns aligned to the right."""
        lines = [self.columns, *self.rows]
        widths = [max(len(line[place]) for line in lines) for place in range(len(self.columns))]
        text = ["  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
        return "\n".join(text + self.notes)

    def markdown(self) -> str:
        """Return the table as Markdown, with the notes below it."""
        lines = [self.columns, ["---", *["---:"] * (len(self.columns) - 1)], *self.rows]
        text = ["| " + " | ".join(line) + " |" for line in lines]
        return "\n".join(text + (["", *self.notes] if self.notes else []))

    def print(self) -> None:
        """Print the table on standard output."""
        print(self.render(), flush=True)


def spread(value: Spread, digits: int = 1) -> str:
    """Return the median with the least and the greatest value, as in `12.3 (12.0 to 14.1)`."""
    return f"{value.median:,.{digits}f} ({value.least:,.{digits}f} to {value.most:,.{digits}f})"
