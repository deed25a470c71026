"""Writes one line per event on standard error, as `key=value` text or as JSON, through the standard library's logging.

Write `logger.info("lease renewed", extra={"event": "lease_renewed", "host": name})`: the extras follow the message.
The name of the event stays the same in later releases, and the message may change. docs/observing.md lists the events.
"""

from __future__ import annotations

import json
import logging
import math
import sys
import threading
from datetime import UTC, datetime
from types import TracebackType

logger = logging.getLogger(__name__)

LEVELS = ("debug", "info", "warning", "error")
FORMATS = ("text", "json")
UNNAMED = "other"
"""The event of a record that names none, such as one of a library."""
_SPECIAL = frozenset(' "=\\')  # a value with one of these characters is quoted
_GRPC_CALLS = "grpc._cython.cygrpc"
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class LineFormatter(logging.Formatter):
    """Formats a record as one line of text. A traceback becomes one quoted value, so the record stays one line."""

    def format(self, record: logging.LogRecord) -> str:
        """The line, without its end."""
        fields = self._fields(record)
        return " ".join([_moment(record), *(f"{key}={_quoted(value)}" for key, value in fields.items())])

    def _fields(self, record: logging.LogRecord) -> dict[str, object]:
        fields: dict[str, object] = {"level": record.levelname.lower(), "logger": record.name}
        fields |= {"event": getattr(record, "event", UNNAMED), "msg": record.getMessage()}
        fields |= {key: value for key, value in vars(record).items() if key not in _STANDARD and key not in fields}
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return fields


class JsonFormatter(LineFormatter):
    """Formats a record as one line of JSON, in ASCII. Numbers and truth values stay as they are."""

    def format(self, record: logging.LogRecord) -> str:
        """The line, without its end."""
        fields = {key: _json_value(value) for key, value in self._fields(record).items()}
        return json.dumps({"time": _moment(record), **fields}, allow_nan=False)


def _moment(record: logging.LogRecord) -> str:
    return datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _json_value(value: object) -> object:
    if value is None or isinstance(value, bool | int | str):
        return value.encode("utf-8", "backslashreplace").decode() if type(value) is str else value
    if isinstance(value, float) and math.isfinite(value):
        return value
    return value.hex() if isinstance(value, bytes) else str(value).encode("utf-8", "backslashreplace").decode()


def _quoted(value: object) -> str:
    text = value.hex() if isinstance(value, bytes) else str(value)
    if text and text.isprintable() and _SPECIAL.isdisjoint(text):
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in escaped) + '"'


def set_up_logging(level: str, form: str = "text") -> None:
    """Send records of `level` (one of LEVELS) and above to standard error, in `form` (one of FORMATS).

    Replaces an earlier set-up.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if form == "json" else LineFormatter())
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    logging.getLogger("grpc").setLevel(logging.WARNING)  # its debug lines, one per call, would hide ours
    logging.getLogger(_GRPC_CALLS).addFilter(_is_to_be_logged)


def log_defects() -> None:
    """Log each unhandled error as one line. Python would write the text of the error as it is.

    The error may contain a text of another program. Ctrl-C is no defect.
    """
    sys.excepthook = _log_defect
    threading.excepthook = lambda failed: _log_defect(failed.exc_type, failed.exc_value, failed.exc_traceback)


def _log_defect(kind: type[BaseException], error: BaseException | None, traceback: TracebackType | None) -> None:
    if not issubclass(kind, KeyboardInterrupt | SystemExit):
        about = (kind, error or kind(), traceback)
        logger.error("a defect: no code handled an error", exc_info=about, extra={"event": "defect"})


def _is_to_be_logged(record: logging.LogRecord) -> bool:
    """Whether to log a record of gRPC: not if it only reports that gRPC could not answer a caller that has gone.

    For each such call gRPC writes a traceback of 3 KB if it does not know of the end of the call yet. If the log had
    these records, callers without any credential could fill it.
    """
    return record.exc_info is None or getattr(record.exc_info[0], "__name__", "") != "ExecuteBatchError"
