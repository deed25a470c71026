"""Output to a terminal has no control characters, and its lines fit."""

from __future__ import annotations

import pytest

from stampede_rt.cli.item_text import item_line
from stampede_rt.cli.payload_text import preview
from stampede_rt.cli.terminal import table_lines
from stampede_rt.escaping import escaped
from stampede_rt.values.model import Item

HOSTILE = "a\x1b]0;title\x07b\r\nforged\u202e\x9b31m"


def item(payload: bytes, **fields: object) -> Item:
    known: dict[str, object] = {
        "time": 0,
        "end": None,
        "duration": None,
        "seq": 1,
        "payload": payload,
        "payload_length_bytes": len(payload),
        "content_type": "",
        "attributes": {},
    }
    return Item(**{name: (known | fields).get(name) for name in Item._fields})


def test_printable_text_is_unchanged() -> None:
    assert escaped("Grüße, 世界 \\n") == "Grüße, 世界 \\n"


def test_control_characters_are_escaped() -> None:
    assert escaped(HOSTILE) == "a\\x1b]0;title\\x07b\\r\\nforged\\u202e\\x9b31m"


@pytest.mark.parametrize("field", ["payload", "attributes", "content_type"])
def test_no_field_of_an_item_brings_control_characters_into_its_line(field: str) -> None:
    values: dict[str, object] = {
        "payload": HOSTILE.encode(),
        "attributes": {HOSTILE: HOSTILE},
        "content_type": HOSTILE,
    }
    payload = values["payload"] if field == "payload" else b"\0"
    assert isinstance(payload, bytes)
    shown = item_line(item(payload, **({} if field == "payload" else {field: values[field]})))
    assert shown.isprintable()
    assert "forged" in shown


def test_a_line_of_text_is_shown_with_its_newline_escaped() -> None:
    assert preview(b"text\n", 5, "") == "text\\n"


def test_bytes_that_are_no_text_are_shown_by_their_length() -> None:
    assert preview(b"\xff\xd8", 2, "image/jpeg") == "[2 bytes image/jpeg]"
    assert preview(b"\0\1", 2, "") == "[2 bytes]"


def test_a_long_text_is_cut_before_it_is_escaped() -> None:
    assert preview(b"\n" * 100, 100, "") == "\\n" * 60 + "... [100 characters]"


ROWS = [["NAME", "KEEPS", "HELD"], ["cam/left", "10 s, 300 items, 256.0 MiB, 4 consumers and more words", "12"]]


def test_a_table_without_a_terminal_is_as_wide_as_it_needs_to_be() -> None:
    assert len(table_lines(ROWS, [False, False, True], None)) == 2


def test_a_table_is_wrapped_to_the_terminals_width() -> None:
    lines = table_lines(ROWS, [False, False, True], 40)
    assert len(lines) > 2
    assert max(map(len, lines)) <= 40
    assert " ".join(" ".join(lines).split()).count("consumers") == 1


def test_in_a_narrow_terminal_a_table_of_many_columns_becomes_lines_of_name_and_value() -> None:
    heads = ["CHANNEL", "HOST", "KEEPS", "EPOCH", "CREATED BY", "HELD", "HELD BYTES", "ACCEPTED"]
    row = ["cam/left", "h1", "10 s, 300 items and 256.0 MiB", "1", "@10.0.0.3", "300", "1234567890", "123456"]
    lines = table_lines([heads, row, row], [False] * 3 + [True] * 5, 40)
    assert max(map(len, lines)) <= 40
    assert lines[:2] == ["CHANNEL     cam/left", "HOST        h1"]
    assert lines[2:4] == ["KEEPS       10 s, 300 items and 256.0", "            MiB"]
    assert lines.count("") == 1
    assert sum(line.startswith("ACCEPTED ") for line in lines) == 2


def test_words_keep_their_least_width_in_a_terminal_that_is_too_narrow() -> None:
    lines = table_lines(ROWS, [False, False, True], 5)
    assert lines[0].split() == ["NAME", "cam/left"]
    assert lines[-1].split() == ["HELD", "12"]
