"""Tables in plain text, in Markdown, and as data for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from stampede_rt_bench.measuring import Spread


class Cell(str):
    """The text of a cell for people, with its `value` for programs."""

    value: object

    def __new__(cls, text: str, value: object) -> Cell:
        """Return `text` with the value."""
        cell = super().__new__(cls, text)
        cell.value = value
        return cell


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

    def values(self) -> dict[str, Any]:
        """Return the table as data for JSON. A row is an object with the columns as its keys."""
        rows = [
            {column: getattr(cell, "value", cell) for column, cell in zip(self.columns, row, strict=True)}
            for row in self.rows
        ]
        return {"rows": rows, "notes": self.notes}


def number(value: float, digits: int = 0) -> Cell:
    """Return a number as in `1,234.5`."""
    return Cell(f"{value:,.{digits}f}", value)


def spread(value: Spread, digits: int = 1) -> Cell:
    """Return the median with the least and the greatest value, as in `12.3 (12.0 to 14.1)`."""
    text = f"{value.median:,.{digits}f} ({value.least:,.{digits}f} to {value.most:,.{digits}f})"
    return Cell(text, asdict(value))
