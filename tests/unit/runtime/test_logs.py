from __future__ import annotations

import logging
import re
import sys

import pytest

from stampede_rt_runtime.logs import LineFormatter


def record(message: str, *args: object, **extra: object) -> logging.LogRecord:
    logger = logging.getLogger("some.module")
    return logger.makeRecord("some.module", logging.WARNING, "file.py", 1, message, args, None, extra=extra)


def test_a_record_is_one_line_of_keys_and_values_with_the_extras_last() -> None:
    line = LineFormatter().format(record("lost %d of %d", 1, 2, host="h1", seq=7))
    assert re.fullmatch(
        r'\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z level=warning logger=some\.module msg="lost 1 of 2" host=h1 seq=7',
        line,
    )


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("plain", "plain"),
        ("", '""'),
        ("two words", '"two words"'),
        ('say "x"', '"say \\"x\\""'),
        ("a\nlevel=error", '"a\\nlevel=error"'),
        ("\x1b[31m", '"\\x1b[31m"'),
        ("back\\slash", '"back\\\\slash"'),
        ("käse", "käse"),
        (b"\x00\xff", "00ff"),
        (None, "None"),
    ],
)
def test_no_value_can_break_or_forge_a_line(value: object, shown: str) -> None:
    assert LineFormatter().format(record("m", value=value)).endswith(f" msg=m value={shown}")


def test_a_traceback_stays_on_the_line() -> None:
    try:
        raise RuntimeError("the cause")
    except RuntimeError:
        failed = record("failed")
        failed.exc_info = sys.exc_info()
    line = LineFormatter().format(failed)
    assert "\n" not in line
    assert "RuntimeError: the cause" in line
