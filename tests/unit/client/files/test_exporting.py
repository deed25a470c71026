"""Tables of items."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stampede_rt.cli.main import main as stampede
from stampede_rt.errors import FileError
from stampede_rt.files import cells, exporting
from stampede_rt.files.entries import Topic, item_entry
from stampede_rt.files.exporting import ExportSummary, export_tables
from stampede_rt.files.sources import McapSource
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from tests.support.files.recordings import INCARNATION, MS, START, gap, item, write

JSON, NPY = "application/json", "application/x-npy"


def parquet_table(path: Path) -> Any:
    import pyarrow.parquet as pq  # not at the top: it takes 0.1 s to load

    return pq.read_table(path)


def npy(value: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, np.asarray(value))
    return file.getvalue()


def file_of(path: Path, payloads: list[bytes], kind: str, name: str = "imu") -> Path:
    topic = Topic(name, kind, INCARNATION)
    items = [item(seq, payload, content_type=kind) for seq, payload in enumerate(payloads, 1)]
    return write(path, [item_entry(topic, one) for one in items])


def export(path: Path, output: Path, form: str, chosen: Callable[[str], bool] = lambda _: True) -> ExportSummary:
    source = McapSource(path)
    try:
        return export_tables(source, output, form, chosen=chosen, start=MIN_INSTANT, end=MAX_INSTANT)
    finally:
        source.close()


def test_json_objects_become_columns_of_csv(tmp_path: Path) -> None:
    payloads = [b'{"a":1,"pose":{"x":0.5,"n":[1,2]}}', b'{"a":"two","ok":true}', b"7"]
    path = file_of(tmp_path / "a.mcap", payloads, JSON)
    summary = export(path, tmp_path / "a.csv", "csv")
    assert summary.rows == {str(tmp_path / "a.csv"): 3}
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["time"] == str(START + MS)
    names = ("seq", "value.a", "value.pose.x", "value.pose.n", "value.ok", "value")
    assert [[row[name] for name in names] for row in rows] == [
        ["1", "1", "0.5", "[1, 2]", "", ""], ["2", "two", "", "", "true", ""], ["3", "", "", "", "", "7"],
    ]  # fmt: skip


def test_json_becomes_parquet_with_types_that_fit_all_items(tmp_path: Path) -> None:
    payloads = [b'{"n":1,"f":1,"b":true,"s":"x","l":[1],"m":1}', b'{"n":2,"f":0.5,"b":null,"l":[0.5],"m":"y"}']
    topic = Topic("imu", "json", INCARNATION)
    items = [
        item(1, payloads[0], content_type=JSON, duration=5, k="v"),
        item(2**40, payloads[1], content_type=JSON, time=START + 7),
    ]
    path = write(tmp_path / "a.mcap", [item_entry(topic, one) for one in items])
    export(path, tmp_path / "a.parquet", "parquet")
    table = parquet_table(tmp_path / "a.parquet")
    assert {field.name: str(field.type).split(" (")[0] for field in table.schema} == {
        "time": "timestamp[ns, tz=UTC]", "duration": "int64", "seq": "uint64", "attributes": "map<string, string",
        "value.n": "int64", "value.f": "double", "value.b": "bool", "value.s": "string", "value.m": "string",
        "value.l": "list<element: double>",
    }  # fmt: skip
    rows = table.drop_columns(["time"]).to_pylist()
    assert rows[0] == {
        "duration": 5, "seq": 1, "attributes": [("k", "v")], "value.n": 1, "value.f": 1.0, "value.b": True,
        "value.s": "x", "value.l": [1.0], "value.m": "1",
    }  # fmt: skip
    assert (rows[1]["seq"], rows[1]["value.s"], rows[1]["value.m"], rows[1]["duration"]) == (2**40, None, "y", None)
    assert table["time"].cast("int64").to_pylist() == [START + MS, START + 7]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_arrays_become_rows_with_their_shape(tmp_path: Path, form: str) -> None:
    path = file_of(tmp_path / "a.mcap", [npy([[1, 2], [3, 4]]), npy([0.5])], NPY)
    export(path, tmp_path / f"a.{form}", form)
    if form == "parquet":
        table = parquet_table(tmp_path / "a.parquet").to_pylist()
        assert [(row["value"], row["shape"]) for row in table] == [([1, 2, 3, 4], [2, 2]), ([0.5], [1])]
    else:
        with (tmp_path / "a.csv").open(newline="") as file:
            assert [row["shape"] for row in csv.DictReader(file)] == ["[2, 2]", "[1]"]


def test_several_channels_become_files_of_a_folder(tmp_path: Path) -> None:
    topics = [Topic(name, "json", INCARNATION) for name in ("rig/a", "rig/b")]
    one = item(1, b"1", content_type=JSON)
    path = write(tmp_path / "a.mcap", [item_entry(topic, one) for topic in topics])
    export(path, tmp_path / "out", "csv")
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["rig_a.csv", "rig_b.csv"]


def test_an_export_that_fails_leaves_no_new_folder_without_tables(tmp_path: Path) -> None:
    texts = [item_entry(Topic(name, "", INCARNATION), item(1, content_type="text/plain")) for name in ("a", "b")]
    number = item_entry(Topic("A", "json", INCARNATION), item(1, b"1", content_type=JSON))
    former = tmp_path / "former"
    former.mkdir()
    for events, output, stays in (
        (texts, tmp_path / "new" / "out", ["former"]),
        (texts, former, ["former"]),
        ([number, *texts], tmp_path / "half", ["former", "half"]),
    ):
        path = write(tmp_path / "a.mcap", events, overwrite=True)
        with pytest.raises(FileError, match="it has the content type 'text/plain'"):
            export(path, output, "csv")
        assert sorted(one.name for one in tmp_path.iterdir() if one.is_dir()) == stays
    assert [one.name for one in (tmp_path / "half").iterdir()] == ["A.csv"]


def test_the_error_for_items_without_a_content_type_says_so(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [item_entry(Topic("a", "", INCARNATION), item(1, content_type=""))])
    with pytest.raises(FileError, match="it has no content type; tables take application/json"):
        export(path, tmp_path / "out", "csv")


def test_gaps_of_the_file_are_reported(tmp_path: Path) -> None:
    one = item_entry(Topic("imu", "json", INCARNATION), item(1, b"1", content_type=JSON))
    path = write(tmp_path / "a.mcap", [one, gap("imu", 2, 5)])
    assert export(path, tmp_path / "a.csv", "csv").gaps == (gap("imu", 2, 5),)


@pytest.mark.parametrize(
    ("payload", "kind", "why"),
    [
        (b"\xff\xd8", "image/jpeg", "content type 'image/jpeg'; tables take"),
        (b"{", JSON, "cannot be decoded as application/json"),
        (b"[" * 100_000, JSON, "cannot be decoded"),
        (b'{"a.b": 1, "a": {"b": 2}}', JSON, "two of its keys would be the column 'value.a.b'"),
        (b"\x93NUMPY\x01\x00", NPY, "cannot be decoded as application/x-npy"),
        (npy(np.zeros(3))[:-20], NPY, "does not fit its length"),
        (npy(0).replace(b"()", b"(9" + b"9" * 12 + b",)").replace(b" " * 14, b"", 1), NPY, "does not fit its length"),
    ],
)
def test_the_error_for_a_value_that_fits_no_table_names_its_channel_and_seq(
    tmp_path: Path, payload: bytes, kind: str, why: str
) -> None:
    path = file_of(tmp_path / "a.mcap", [payload], kind)
    with pytest.raises(FileError, match=f"channel 'imu', item 1 at .*{why}"):
        export(path, tmp_path / "a.csv", "csv")
    assert not (tmp_path / "a.csv").exists()


def test_an_export_accepts_lone_surrogates_and_very_large_numbers(tmp_path: Path) -> None:
    path = file_of(tmp_path / "a.mcap", [b'{"\\ud800":"\\udfff","n":%d,"l":[%d]}' % (2**70, 2**70)], JSON)
    for form in ("csv", "parquet"):
        export(path, tmp_path / f"a.{form}", form)
    (row,) = parquet_table(tmp_path / "a.parquet").to_pylist()
    assert row["value.\\ud800"] == "\\udfff"
    assert row["value.n"] == str(2**70)


def test_too_many_different_keys_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "COLUMNS_MAX", 10)
    path = file_of(tmp_path / "a.mcap", [b'{"%d":1}' % number for number in range(20)], JSON)
    with pytest.raises(FileError, match="too many for a table"):
        export(path, tmp_path / "a.csv", "csv")


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = file_of(tmp_path / "a.mcap", [b"1"], JSON)
    (tmp_path / "a.csv").write_text("precious")
    with pytest.raises(FileError, match="exists"):
        export(path, tmp_path / "a.csv", "csv")
    assert (tmp_path / "a.csv").read_text() == "precious"


def test_the_command_says_how_many_more_gaps_there_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    topic = Topic("imu", JSON, INCARNATION)
    pairs = [
        (item_entry(topic, item(seq, b"1", content_type=JSON)), gap("imu", seq + 1, seq + 1)) for seq in range(1, 50, 2)
    ]
    path = write(tmp_path / "a.mcap", [event for pair in pairs for event in pair])
    assert stampede(["export", str(path), "-o", str(tmp_path / "a.csv")]) == 3
    printed = capsys.readouterr().out.splitlines()
    assert len([line for line in printed if line.startswith("missing: imu")]) == 20
    assert printed[-1] == "missing: 5 more gaps"


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_an_export_that_fails_leaves_no_part_of_a_table_and_the_former_table_stays(
    tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporting, "ROWS_PER_WRITE", 1)
    path, output = file_of(tmp_path / "a.mcap", [b"1", b"2"], JSON), tmp_path / f"a.{form}"
    output.write_bytes(b"the former table")
    source, read = McapSource(path), []

    def damaged_at_the_end(*arguments: Any) -> Any:
        read.append(1)
        yield from McapSource.events(source, *arguments)
        if len(read) == 2:  # the table is being written
            raise FileError("the file is damaged")

    monkeypatch.setattr(source, "events", damaged_at_the_end)
    with pytest.raises(FileError, match="is damaged"):
        export_tables(source, output, form, chosen=lambda _: True, start=MIN_INSTANT, end=MAX_INSTANT, overwrite=True)
    source.close()
    assert output.read_bytes() == b"the former table"
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted(["a.mcap", output.name])


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("payloads", "values"),
    [
        ([b"1764451234123456789", b"0.5"], ["1764451234123456789", "0.5"]),
        ([b"[1764451234123456789]", b"[0.5]"], ["[1764451234123456789]", "[0.5]"]),
        ([b"[1764451234123456789, 0.5]"], ["[1764451234123456789, 0.5]"]),
        ([b"1764451234123456789", b"7", b"0.5"], ["1764451234123456789", "7", "0.5"]),
    ],
)
def test_a_table_rounds_no_whole_number(tmp_path: Path, form: str, payloads: list[bytes], values: list[str]) -> None:
    output = tmp_path / f"a.{form}"
    export(file_of(tmp_path / "a.mcap", payloads, JSON), output, form)
    if form == "parquet":
        assert parquet_table(output).column("value").to_pylist() == values
    else:
        with output.open(newline="") as file:
            assert [one["value"] for one in csv.DictReader(file)] == values


def test_a_column_of_only_whole_numbers_keeps_numbers_that_no_float_has(tmp_path: Path) -> None:
    payloads = [b'{"a":9007199254740993,"b":[9007199254740993]}', b'{"a":1,"b":[2]}']
    export(file_of(tmp_path / "a.mcap", payloads, JSON), tmp_path / "a.parquet", "parquet")
    table = parquet_table(tmp_path / "a.parquet")
    assert table.column("value.a").to_pylist() == [2**53 + 1, 1]
    assert table.column("value.b").to_pylist() == [[2**53 + 1], [2]]


def test_an_object_with_a_repeated_key_is_refused(tmp_path: Path) -> None:
    path = file_of(tmp_path / "a.mcap", [b'{"a":{"b":1,"b":2}}'], JSON)
    with pytest.raises(FileError, match=r"channel 'imu', item 1 at .*: an object in it has the same key twice"):
        export(path, tmp_path / "a.csv", "csv")


def test_an_array_in_an_array_keeps_all_its_numbers(tmp_path: Path) -> None:
    inner = np.linspace(0, 1, 2000)
    array = np.zeros(1, dtype=[("scan", "f8", (2000,))])
    array["scan"] = inner
    export(file_of(tmp_path / "a.mcap", [npy(array)], NPY), tmp_path / "a.csv", "csv")
    csv.field_size_limit(10**6)
    with (tmp_path / "a.csv").open(newline="") as file:
        [row] = csv.DictReader(file)
    assert json.loads(row["value"]) == [[inner.tolist()]]
