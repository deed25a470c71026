"""Log lines as text and as JSON."""

from __future__ import annotations

import json
import logging
import re
import subprocess
import sys

import pytest
from grpc._cython import cygrpc  # type: ignore[attr-defined]  # the class and its logger are private

from stampede_rt_runtime.logs import JsonFormatter, LineFormatter, set_up_logging


def record(message: str, *args: object, **extra: object) -> logging.LogRecord:
    logger = logging.getLogger("some.module")
    return logger.makeRecord("some.module", logging.WARNING, "file.py", 1, message, args, None, extra=extra)


def test_a_record_is_one_line_of_keys_and_values_with_the_extras_last() -> None:
    line = LineFormatter().format(record("lost %d of %d", 1, 2, event="lost", host="h1", seq=7))
    assert re.fullmatch(
        r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z level=warning logger=some\.module event=lost "
        r'msg="lost 1 of 2" host=h1 seq=7',
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


def test_a_traceback_is_written_on_one_line() -> None:
    try:
        raise RuntimeError("the cause")
    except RuntimeError:
        failed = record("failed")
        failed.exc_info = sys.exc_info()
    line = LineFormatter().format(failed)
    assert "\n" not in line
    assert "RuntimeError: the cause" in line


def test_a_record_is_one_json_object_with_its_event_and_numbers_as_numbers() -> None:
    line = JsonFormatter().format(record("lost %d", 1, event="lost", host="h1", seq=7, late=0.5, far=float("inf")))
    fields = json.loads(line)
    assert fields.pop("time").endswith("Z")
    assert fields == {
        "level": "warning", "logger": "some.module", "event": "lost", "msg": "lost 1", "host": "h1", "seq": 7,
        "late": 0.5, "far": "inf",
    }  # fmt: skip


@pytest.mark.parametrize("value", ["a\nb", "\x1b[31m", '"}', "\ud800", b"\x00", None, object()])
def test_a_json_line_has_no_control_character_for_any_values(value: object) -> None:
    line = JsonFormatter().format(record("m %s", "\r\n\x9b", value=value))
    assert line.isascii()
    assert line.isprintable()
    json.loads(line)


def test_a_record_without_an_event_has_the_event_other() -> None:
    assert json.loads(JsonFormatter().format(record("m")))["event"] == "other"
    assert " event=other " in LineFormatter().format(record("m"))


def test_the_log_has_no_line_for_a_caller_that_has_gone_before_its_answer(capsys: pytest.CaptureFixture[str]) -> None:
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    try:
        set_up_logging("info")
        for error in (cygrpc.ExecuteBatchError("Failed"), ValueError("a defect")):
            try:
                raise error
            except Exception:
                logging.getLogger("grpc._cython.cygrpc").exception("%s raised by servicer method", type(error).__name__)
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)
    logged = capsys.readouterr().err
    assert "ExecuteBatchError" not in logged
    assert "a defect" in logged


def test_an_unhandled_error_is_one_line_in_the_main_thread_and_in_others() -> None:
    script = (
        "import threading\n"
        "from stampede_rt_runtime.logs import log_defects, set_up_logging\n"
        "def fail(): raise ValueError('a\\r\\nforged\\x1b[2J\\u202e')\n"
        "set_up_logging('info')\n"
        "log_defects()\n"
        "one = threading.Thread(target=fail)\n"
        "one.start()\n"
        "one.join()\n"
        "fail()\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=30, check=False)
    *lines, rest = ended.stderr.decode().split("\n")
    assert (ended.returncode, len(lines), rest) == (1, 2, "")
    for line in lines:
        assert line.isprintable()
        assert " event=defect " in line
        assert "ValueError: a\\r\\nforged\\x1b[2J\\u202e" in line
