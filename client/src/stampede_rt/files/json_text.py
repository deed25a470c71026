"""Reads JSON of files, which other programs may have written. Pure."""

from __future__ import annotations

import json
import re
from typing import Any

_HALF_OF_PAIR = re.compile(r"\\u[dD]")


def read_json(content: bytes | str) -> Any:
    """Return the value of JSON in UTF-8. Raises ValueError or RecursionError for anything else.

    JSON may escape a half of a surrogate pair. No channel, file or table can take such a text, so it is an error, too.
    """
    text = content if isinstance(content, str) else content.decode()
    value = json.loads(text)
    if _HALF_OF_PAIR.search(text):
        try:
            json.dumps(value, ensure_ascii=False).encode()
        except UnicodeEncodeError as error:
            raise ValueError("a text has a half of a surrogate pair") from error
    return value
