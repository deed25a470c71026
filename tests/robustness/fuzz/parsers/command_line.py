"""The command line: any words as arguments, and any item on the terminal."""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
from collections.abc import Iterator
from typing import Any

from stampede_rt.cli import item_text, output
from stampede_rt.cli.commands import full_parser
from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Item
from tests.robustness.fuzz import hostile_values
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.parsers.target import Target
from tests.robustness.fuzz.parsers.texts import composed

WORDS = (
    *("ls", "put", "get", "echo", "hz", "doctor", "group", "queue", "mailbox", "peers", "info", "rm", "create", "take"),
    *("--help", "-h", "--url", "localhost:1", "-o", "json", "--limit", "--start", "--end", "--max-age", "--attribute"),
)


def arguments(source: ByteSource) -> None:
    """Check that errors about arguments contain no byte that a terminal takes for a command."""
    words = [source.choice(WORDS) if source.chance(60) else composed(source) for _ in range(source.below(7))]
    with _printed() as printed, contextlib.suppress(SystemExit):
        _parser().parse_args(words)
    _check_lines(printed.getvalue())


def items(source: ByteSource) -> None:
    """Items of other programs, printed in all forms."""
    item = _item(source)
    with _printed() as printed:
        print(item_text.item_line(item))
    assert printed.getvalue().count("\n") == 1, "an item has one line"
    _check_lines(printed.getvalue())
    rows: list[dict[str, Any]] = [{"name": hostile_values.text(source), "at": hostile_values.integer(source)}]
    for form in ("table", "json", "jsonl"):
        with _printed() as printed:
            output.print_rows(rows, form, none="")
            output.print_rows([item_text.item_row(item)], form, none="")
            output.print_facts({"fact": hostile_values.text(source)}, form)
        _check_lines(printed.getvalue())


def _item(source: ByteSource) -> Item:
    payload = hostile_values.text(source).encode() if source.chance(50) else hostile_values.blob(source)
    return Item(
        time=source.choice((0, 10**18, 2**63 - 1, -(2**63))),
        end=source.choice((None, 10**18)),
        duration=source.choice((None, 0, 5, 2**63 - 1)),
        seq=1 + source.below(100),
        incarnation=1,
        payload=source.choice((payload, None)),
        payload_length_bytes=len(payload),
        content_type=hostile_values.text(source),
        attributes={hostile_values.text(source): hostile_values.text(source)},
    )


@functools.cache
def _parser() -> argparse.ArgumentParser:
    return full_parser()


@contextlib.contextmanager
def _printed() -> Iterator[io.StringIO]:
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
        yield text


def _check_lines(printed: str) -> None:
    strange = [one for one in printed if not one.isprintable() and one != "\n"]
    assert not strange, f"{strange!r} reaches the terminal, in {printed[:300]!r}"


TARGETS = (Target("arguments", arguments, ()), Target("items", items, (StampedeError,)))
