"""Writes one line per event on standard error, in `key=value` form, through the standard library's logging.

Write `logger.info("lease renewed", extra={"host": name, "ttl_nanos": ttl})`: the extras follow the message.
"""

from __future__ import annotations

import logging
import sys
from datetime import UTC, datetime

LEVELS = ("debug", "info", "warning", "error")
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class LineFormatter(logging.Formatter):
    """Formats a record as one line. A traceback becomes one quoted value, so that each record stays one line."""

    def format(self, record: logging.LogRecord) -> str:
        """The line, without its end."""
        moment = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        fields: dict[str, object] = {"level": record.levelname.lower(), "logger": record.name}
        fields["msg"] = record.getMessage()
        fields |= {key: value for key, value in vars(record).items() if key not in _STANDARD}
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return " ".join([moment.replace("+00:00", "Z"), *(f"{key}={_quoted(value)}" for key, value in fields.items())])


def _quoted(value: object) -> str:
    text = value.hex() if isinstance(value, bytes) else str(value)
    if text and text.isprintable() and not any(c in ' "=\\' for c in text):
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in escaped) + '"'


def set_up_logging(level: str) -> None:
    """Send records of `level` (one of LEVELS) and above to standard error. Replaces an earlier set-up."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(LineFormatter())
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    logging.getLogger("grpc").setLevel(logging.WARNING)  # its debug lines, one per call, would hide ours
