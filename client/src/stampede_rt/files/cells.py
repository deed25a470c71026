"""Values of items as cells of a table. Pure, except that arrays need numpy."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from stampede_rt.errors import FileError

JSON = "application/json"
NPY = "application/x-npy"
DEPTH_MAX = 8  # the levels of nested objects that become columns; deeper objects become JSON text
COLUMNS_MAX = 1000
INT_MAX = 2**63 - 1
EXACT_MAX = 2**53  # a float can represent every whole number up to this one
BOOL, INT, LONG, FLOAT, TEXT = "bool", "int", "long", "float", "text"
INTS, LONGS, FLOATS = "ints", "longs", "floats"  # lists of such numbers
# A column with cells of these two kinds gets the kind of the key. An int is exact as a float, and a long is not.
_JOINED = {FLOAT: {INT, FLOAT}, LONG: {INT, LONG}, FLOATS: {INTS, FLOATS}, LONGS: {INTS, LONGS}}
Cell = Any
Row = dict[str, Cell]


def cells_of(payload: bytes, content_type: str) -> Row:
    """Return the cells of a payload by column. Raises FileError if it is neither JSON nor an array of numpy."""
    media = content_type.partition(";")[0].strip().lower()
    try:
        if media == JSON:
            return _row_of(json.loads(payload, object_pairs_hook=_object_of))
        if media == NPY:
            return _array_cells(payload)
    except (ValueError, RecursionError, TypeError, SyntaxError) as error:
        raise FileError(f"it cannot be decoded as {media}: {error}") from error
    found = f"the content type {content_type!r}" if content_type else "no content type"
    raise FileError(f"it has {found}; tables take {JSON} and {NPY}; export it as MCAP, or choose other channels")


def _object_of(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise FileError("an object in it has the same key twice; export it as MCAP")
    return found


def _row_of(value: Any) -> Row:
    row: Row = {}
    for name, cell in _flat("value", value, 0):
        if name in row:  # such as the key "a.b" beside the key "b" of the object "a"
            raise FileError(f"two of its keys would be the column {name!r}; export it as MCAP")
        row[name] = cell
    return row


def _flat(name: str, value: Any, depth: int) -> Iterator[tuple[str, Cell]]:
    if isinstance(value, dict) and value and depth < DEPTH_MAX:
        for key, inner in value.items():
            yield from _flat(f"{name}.{_encodable(key)}", inner, depth + 1)
    else:
        yield name, value


def _encodable(text: str) -> str:
    """Return text that UTF-8 can encode. JSON may have halves of surrogate pairs."""
    return text.encode("utf-8", "backslashreplace").decode()


def _array_cells(payload: bytes) -> Row:
    """Return the numbers of an array in one row, and its shape. Checks the length first, because a header may be
    wrong."""
    import numpy as np

    file = io.BytesIO(payload)
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(payload) - file.tell():
        raise ValueError("its header does not fit its length")
    array = np.lib.format.read_array(io.BytesIO(payload), allow_pickle=False)
    return {"value": array.ravel().tolist(), "shape": list(array.shape)}


def kind_of(cell: Cell) -> str | None:
    """Return the kind of a cell; None for an empty one."""
    if cell is None:
        return None
    if isinstance(cell, bool):
        return BOOL
    if isinstance(cell, int):
        return INT if abs(cell) <= EXACT_MAX else LONG if abs(cell) <= INT_MAX else TEXT
    if isinstance(cell, float):
        return FLOAT
    if isinstance(cell, list) and all(type(one) in (int, float) for one in cell):
        most = max((abs(one) for one in cell if type(one) is int), default=0)
        if any(type(one) is float for one in cell):
            return FLOATS if most <= EXACT_MAX else TEXT
        return INTS if most <= EXACT_MAX else LONGS if most <= INT_MAX else TEXT
    return TEXT


def joined_kind(first: str | None, second: str | None) -> str | None:
    """Return the kind of a column that has cells of both kinds."""
    if first == second or second is None:
        return first
    if first is None:
        return second
    both = {first, second}
    return next((joined for joined, kinds in _JOINED.items() if both == kinds), TEXT)


def as_kind(cell: Cell, kind: str) -> Cell:
    """Return a cell in the form of its column. In a column of text, every value that is no text becomes JSON."""
    if cell is None:
        return None
    if kind == TEXT:
        return _encodable(cell if isinstance(cell, str) else json.dumps(cell, ensure_ascii=False, default=_plain))
    if kind == FLOAT:
        return float(cell)
    return [float(one) for one in cell] if kind == FLOATS else cell


def _plain(value: Any) -> Any:
    """Convert a value that JSON does not have: an array to lists, any other value to text.

    An array does not become text, because numpy shortens the text of a long array.
    """
    return value.tolist() if hasattr(value, "ndim") and value.ndim else str(value)


class Columns:
    """The columns of a table, and the kind of each."""

    def __init__(self) -> None:
        self.kinds: dict[str, str | None] = {}

    def learn(self, row: Mapping[str, Cell]) -> None:
        """Look at a row. Raises FileError if there are too many columns."""
        for name, cell in row.items():
            self.kinds[name] = joined_kind(self.kinds.get(name), kind_of(cell))
        if len(self.kinds) > COLUMNS_MAX:
            raise FileError(f"its items have more than {COLUMNS_MAX} different keys, too many for a table")

    def cells(self, row: Mapping[str, Cell]) -> Sequence[Cell]:
        """Return the cells of a row in the order of the columns."""
        return [as_kind(row.get(name), kind or TEXT) for name, kind in self.kinds.items()]
