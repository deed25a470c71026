"""Writes the items of a file as tables: CSV, or Parquet with pyarrow. One table for each topic."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from stampede_rt.errors import FileError
from stampede_rt.files.cells import BOOL, FLOAT, FLOATS, INT, INTS, LONG, LONGS, Columns, cells_of
from stampede_rt.files.entries import FileEntry
from stampede_rt.files.file_source import FileSource, none_chosen
from stampede_rt.files.names import channel_name
from stampede_rt.files.writing import PART_SUFFIX, opened_new, replaced, write_fault
from stampede_rt.values.recording import GAPS_KEPT_MAX, RecordingGap

ROWS_PER_WRITE = 4096
BYTES_PER_WRITE = 8 * 1024 * 1024  # the payload bytes that one write of a table gathers
FORMATS = ("csv", "parquet")
FIRST_COLUMNS = ("time", "duration", "seq", "attributes")


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportSummary:
    """The rows of each table by its file, and the first 1000 gaps of the exported channels.

    `damaged` says which items or channels the source may lack besides the gaps.
    """

    rows: Mapping[str, int]
    gaps: Sequence[RecordingGap]
    damaged: Sequence[str]

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        return not self.gaps and not self.damaged


class TableWriter(Protocol):
    """Writes one table."""

    def write(self, entries: Sequence[FileEntry], cells: Sequence[Sequence[Any]]) -> None:
        """Write rows."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...


class CsvTable:
    """A table as CSV in UTF-8. Times and durations are nanoseconds. Lists and attributes are JSON."""

    def __init__(self, path: Path, columns: Columns) -> None:
        opened_new(path, overwrite=True).close()
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file)
        self._writer.writerow([*FIRST_COLUMNS, *columns.kinds])

    def write(self, entries: Sequence[FileEntry], cells: Sequence[Sequence[Any]]) -> None:
        """Write rows."""
        for entry, row in zip(entries, cells, strict=True):
            attributes = json.dumps(dict(entry.attributes), ensure_ascii=False) if entry.attributes else ""
            texts = [json.dumps(cell) if isinstance(cell, list | bool) else cell for cell in row]
            self._writer.writerow([entry.time, entry.duration, _seq(entry), attributes, *texts])

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class ParquetTable:
    """A table as Parquet. Times are timestamps in UTC, durations nanoseconds, attributes a map."""

    def __init__(self, path: Path, columns: Columns) -> None:
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ImportError as error:
            raise FileError("Parquet needs pyarrow; run: pip install 'stampede-rt[parquet]'") from error
        types = {
            BOOL: pa.bool_(), INT: pa.int64(), LONG: pa.int64(), FLOAT: pa.float64(), INTS: pa.list_(pa.int64()),
            LONGS: pa.list_(pa.int64()), FLOATS: pa.list_(pa.float64()),
        }  # fmt: skip
        first_types = (pa.timestamp("ns", "UTC"), pa.int64(), pa.uint64(), pa.map_(pa.string(), pa.string()))
        first_columns = zip(FIRST_COLUMNS, first_types, strict=True)
        values = [(name, types.get(kind or "", pa.string())) for name, kind in columns.kinds.items()]
        self._pa, self._schema = pa, pa.schema([*first_columns, *values])
        opened_new(path, overwrite=True).close()
        self._writer = pq.ParquetWriter(str(path), self._schema, compression="zstd")

    def write(self, entries: Sequence[FileEntry], cells: Sequence[Sequence[Any]]) -> None:
        """Write rows."""
        first_columns: list[list[Any]] = [
            [entry.time for entry in entries],
            [entry.duration for entry in entries],
            [_seq(entry) for entry in entries],
            [list(entry.attributes.items()) for entry in entries],
        ]
        columns = [*first_columns, *(list(column) for column in zip(*cells, strict=True))]
        arrays = [self._pa.array(column, field.type) for column, field in zip(columns, self._schema, strict=True)]
        self._writer.write_table(self._pa.Table.from_arrays(arrays, schema=self._schema))

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()


def _seq(entry: FileEntry) -> int:
    return entry.sequence if entry.seq is None else entry.seq


_TABLES: dict[str, Callable[..., TableWriter]] = {"csv": CsvTable, "parquet": ParquetTable}


def export_tables(
    source: FileSource,
    output: str | os.PathLike[str],
    form: str,
    *,
    chosen: Callable[[str], bool],
    start: int,
    end: int,
    overwrite: bool = False,
) -> ExportSummary:
    """Write a table for each chosen topic of JSON or arrays. `form` is "csv" or "parquet".

    One topic becomes the file `output`. Several become files in the folder `output`, by their names. Reads the source
    twice for each topic, and keeps at most 4096 rows in memory. Raises FileError.
    """
    names = [topic.name for topic in source.topics(chosen)]
    if not names:
        raise FileError(none_chosen(source))
    rows: dict[str, int] = {}
    gaps: list[RecordingGap] = []
    with _folder(Path(output), needed=len(names) > 1):
        for name, path in zip(names, _paths(names, Path(output), form), strict=True):
            try:
                rows[str(path)] = _export(_Topic(source, name, start, end, gaps), path, form, overwrite)
            except OSError as error:
                raise write_fault(f"{path}{PART_SUFFIX}", error) from error
    return ExportSummary(rows=rows, gaps=tuple(gaps[:GAPS_KEPT_MAX]), damaged=tuple(source.damaged))


@contextmanager
def _folder(path: Path, *, needed: bool) -> Iterator[None]:
    """Make a folder if it is `needed`. After an error there is no new folder without files. Raises FileError."""
    made: list[Path] = []
    if needed:
        made = [one for one in (path, *path.parents) if not one.exists()]
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise write_fault(path, error) from error
    try:
        yield
    except BaseException:
        with suppress(OSError):  # a folder with tables stays
            for one in made:
                one.rmdir()
        raise


def _paths(names: Sequence[str], output: Path, form: str) -> list[Path]:
    if len(names) == 1:
        return [output]
    paths = [output / f"{channel_name(name).replace('/', '_')}.{form}" for name in names]
    if len(set(paths)) < len(paths):
        raise FileError(f"two of the channels {', '.join(map(repr, names[:10]))} would be one file; export each alone")
    return paths


@dataclass(frozen=True, slots=True)
class _Topic:
    """The items of one topic."""

    source: FileSource
    name: str
    start: int
    end: int
    gaps: list[RecordingGap]

    def entries(self, *, collect_gaps: bool = False) -> Iterator[FileEntry]:
        for _, event in self.source.events(lambda name: name == self.name, self.start, self.end):
            if isinstance(event, FileEntry):
                yield event
            elif isinstance(event, RecordingGap) and collect_gaps and len(self.gaps) < GAPS_KEPT_MAX:
                self.gaps.append(event)

    def cells(self, entry: FileEntry) -> dict[str, Any]:
        try:
            return cells_of(entry.data, entry.content_type)
        except FileError as error:
            raise FileError(f"channel {self.name!r}, item {_seq(entry)} at {entry.time}: {error.message}") from error


def _export(topic: _Topic, path: Path, form: str, overwrite: bool) -> int:
    with replaced(path, overwrite=overwrite) as written:
        columns = Columns()
        for entry in topic.entries(collect_gaps=True):
            columns.learn(topic.cells(entry))
        table, rows = _TABLES[form](written, columns), 0
        try:
            for part in _parts(topic.entries()):
                table.write(part, [columns.cells(topic.cells(entry)) for entry in part])
                rows += len(part)
        finally:
            table.close()
    return rows


def _parts(entries: Iterator[FileEntry]) -> Iterator[list[FileEntry]]:
    part: list[FileEntry] = []
    length_bytes = 0
    for entry in entries:
        part.append(entry)
        length_bytes += len(entry.data)
        if len(part) >= ROWS_PER_WRITE or length_bytes >= BYTES_PER_WRITE:
            yield part
            part, length_bytes = [], 0
    if part:
        yield part
