"""Numbers, texts and bytes at which parsers and rules of all kinds have failed."""

from __future__ import annotations

import math

from tests.robustness.fuzz.drawing import ByteSource

NANOS = 1_700_000_000 * 10**9
INTEGERS = (
    *(0, 1, 2, 3, 5, 16, 100, 255, 256, 1000, 4096, 65535, 65536, 2**20),
    *(-1, -2, 10**9, 3600 * 10**9, NANOS, NANOS + 1, 2**31 - 1, 2**31, -(2**31), 2**32 - 1, 2**32),
    *(2**53, 2**61, 2**62, 2**63 - 1, 2**63 - 2, 2**63, -(2**63), -(2**63) + 1, 2**64 - 1),
)
FLOATS = (0.0, 1.0, -0.0, 0.5, -1.0, 1e-308, 1e308, math.inf, -math.inf, math.nan)
TEXTS = (
    *("", "a", "b", "a/b", "a.b", "a-b", "*", "**", "?", "[a-z]", "[!", "[", "*a" * 12, "a" * 200, "a" * 5000),
    *("\0", "\x1b[2J", "\x07", "\r\nforged", "\u202e", "é", "e\u0301", "\U0001f984", "\ufeff", "ß", "İ", "\x85"),
    *("../../etc", "/", "-", "--help", "%s%n", "{0}", "${HOME}", "localhost:1", "localhost:99999", "[::1]:1", "[", ":"),
    *(
        "127.0.0.1:1",
        "256.1.1.1:1",
        "a:b:c",
        "dns:///x:1",
        "unix:/tmp/x",
        "http://x",
        "1e9",
        "nan",
        "inf",
        "-1",
        "0x10",
    ),
    *("10s", "1h30m", "-5ms", "9" * 400 + "s", "1" * 5000, "now", "now-1h", "2024-02-30", "9999-12-31T23:59:60Z"),
    *(
        "text/plain",
        "a/b; c=\x1b",
        " ",
        " a",
        "a ",
        "\t",
        "None",
        "null",
        "true",
        "[]",
        "{}",
        '"',
        "'",
        "\\",
    ),
)


def integer(source: ByteSource) -> int:
    """Any integer, often an unusual one."""
    if source.chance(25):
        return int.from_bytes(source.take(8), signed=True)
    return source.choice(INTEGERS) + (source.below(5) - 2 if source.chance(20) else 0)


def text(source: ByteSource) -> str:
    """Any text without lone surrogates."""
    if source.chance(20):
        return source.take(source.below(40)).decode("utf-8", errors="replace")
    return source.choice(TEXTS) + (source.choice(TEXTS) if source.chance(15) else "")


def blob(source: ByteSource) -> bytes:
    """Any bytes, sometimes very many."""
    if source.chance(50):
        return source.take(source.choice((16, 0, 1, 8, 15, 17, 32, 200)))
    return source.choice((b"", b"\0", b"\0" * 16, b"\xff" * 16, b"x" * 300, b"y" * 7000, b"\x80\x04K\x01."))
