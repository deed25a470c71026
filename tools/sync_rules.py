"""The rules that turn the source of the asynchronous client into the source of the blocking client."""

from __future__ import annotations

import re

HEADER = "# Generated from ../_async by tools/generate.py; do not edit.\n"

WORDS = {
    "AsyncIterator": "Iterator",
    "AsyncGenerator": "Generator",
    "AsyncContextManager": "ContextManager",
    "__aenter__": "__enter__",
    "__aexit__": "__exit__",
    "__aiter__": "__iter__",
    "__anext__": "__next__",
    "StopAsyncIteration": "StopIteration",
    "asynccontextmanager": "contextmanager",
    "aclose": "close",
    "_async": "_sync",
    "grpc_async": "grpc_sync",
    "streams_async": "streams_sync",
    "ring_waiting_async": "ring_waiting_sync",
    "concurrency_async": "concurrency_sync",
    "multicast_async": "multicast_sync",
}


def synchronous(source: str) -> str:
    """Remove `async` and `await` from `source`, and use the blocking names. Changes whole words, also in docstrings."""
    source = re.sub(r"\b(async|await) +(?=[\w(])", "", source)
    source = re.sub(r"Awaitable\[([^\[\]]+)\]", r"\1", source)
    source = re.sub(r"(import .*?)Awaitable, ", r"\1", source)
    for word, replacement in WORDS.items():
        source = re.sub(rf"(?<![A-Za-z0-9_]){re.escape(word)}(?![A-Za-z0-9_])", replacement, source)
    return HEADER + source
