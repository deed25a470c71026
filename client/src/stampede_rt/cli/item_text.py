"""Items as lines: for people, for programs, or as the option --format says."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from string import Formatter
from typing import Any

from stampede_rt.cli.arguments import checked
from stampede_rt.cli.colours import styled
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import attributes_text, payload_fields
from stampede_rt.cli.payload_text import preview, text_of
from stampede_rt.errors import InvalidArgument
from stampede_rt.escaping import escaped
from stampede_rt.values.model import Item
from stampede_rt.values.timeline import format_duration

FIELDS = ("time", "time_ns", "end_ns", "duration_ns", "seq", "channel", "payload", "length", "content_type")
FORMAT_HELP = (
    "how to print an item, such as '{time} {seq:06d} {payload}\\t{attributes[enc]}'; the fields are "
    f"{', '.join(FIELDS)} and attributes[KEY]; \\n and \\t count as in Python"
)
WIDTH_MAX = 1000  # the most characters of one field of a format
Form = list[tuple[str, str | None, str | None, str | None]]


def add_item_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for the form of items."""
    parser.add_argument("--no-payloads", action="store_true", help="print times and lengths only")
    parser.add_argument("--format", type=checked(parse_format), metavar="FORMAT", help=FORMAT_HELP.replace("%", "%%"))


def parse_format(text: str) -> Form:
    """Return the parts of a format. Raises InvalidArgument, which names the wrong part."""
    for escape, character in (("\\n", "\n"), ("\\t", "\t")):
        text = text.replace(escape, character)
    try:
        parts = list(Formatter().parse(text))
    except ValueError as error:
        raise InvalidArgument(f"the format cannot be read: {error}; write {{{{ for a brace") from None
    for _, name, spec, conversion in parts:
        if name is not None:
            _check_field(name, spec or "", conversion)
    return parts


def _check_field(name: str, spec: str, conversion: str | None) -> None:
    if name not in FIELDS and not (name.startswith("attributes[") and name.endswith("]")):
        raise InvalidArgument(f"the format has no field {name!r}; write {', '.join(FIELDS)} or attributes[KEY]")
    width = "".join(one for one in spec if one.isdigit())
    is_character = spec.endswith("c")  # a number as a character could be a control code of the terminal
    if conversion or "{" in spec or is_character or (width and int(width[:9]) > WIDTH_MAX):
        raise InvalidArgument(f"the format of {name!r} is not allowed; write a width such as {{seq:06d}}")


def item_printer(arguments: argparse.Namespace) -> Callable[..., str]:
    """Return the function that formats an item as one line, from the item, its channel, and whether it is late."""
    if arguments.format is not None:
        return lambda item, channel="", late=False: formatted(arguments.format, item, channel)
    if arguments.output == "table":
        return item_line
    return lambda item, channel="", late=None: json.dumps(_named(channel) | item_row(item) | _lateness(late))


def print_losses(losses: int) -> None:
    """Print on standard error how many gaps of lost items the reader got."""
    if losses:
        why = "a replica replaced a lost host and may have lacked items, or the archive lacks items"
        print(f"stampede: {losses} gaps of lost items: {why}", file=sys.stderr)


def print_dropped(dropped: int) -> None:
    """Say on standard error how many items a subscription did not get, if there are any."""
    if dropped:
        print(f"stampede: retention collected {dropped} items before they could be printed", file=sys.stderr)


def _named(channel: str) -> dict[str, str]:
    return {"channel": channel} if channel else {}


def _lateness(late: bool | None) -> dict[str, bool]:
    return {} if late is None else {"late": late}


def formatted(form: Form, item: Item, channel: str) -> str:
    """Return an item by a format. Raises InvalidArgument if a value does not fit its format, such as a missing time."""
    values: dict[str, Any] = {
        "time": instant_text(item.time),
        "time_ns": item.time,
        "end_ns": item.end,
        "duration_ns": item.duration,
        "seq": item.seq,
        "channel": channel,
        "payload": _payload(item),
        "length": item.payload_length_bytes,
        "content_type": escaped(item.content_type),
    }
    pieces = []
    for literal, name, spec, _ in form:
        pieces.append(literal)
        if name is None:
            continue
        value = values[name] if name in values else escaped(item.attributes.get(name[11:-1], ""))
        try:
            pieces.append(format("-" if value is None else value, spec or ""))
        except ValueError as error:
            raise InvalidArgument(f"the format of {name!r} does not fit {value!r}: {error}") from None
    return "".join(pieces)


def _payload(item: Item) -> str:
    """Return a payload as one line: a text as a whole, other bytes as `preview` shows them."""
    text = None if item.payload is None else text_of(item.payload)
    if text is None or "\0" in text:
        return preview(item.payload, item.payload_length_bytes, item.content_type)
    return escaped(text)


def item_row(item: Item) -> dict[str, Any]:
    """Return the fields of an item for JSON. See `payload_fields` for its payload."""
    row: dict[str, Any] = {
        "time": item.time,
        "end": item.end,
        "duration": item.duration,
        "seq": item.seq,
        "length_bytes": item.payload_length_bytes,
        "content_type": item.content_type,
        "attributes": dict(item.attributes),
    }
    return row if item.payload is None else row | payload_fields(item.payload)


def item_line(item: Item, channel: str = "", late: bool | None = None) -> str:
    """Return an item as one line for people."""
    named = f"{channel} " if channel else ""
    duration = f" for {format_duration(item.duration)}" if item.duration is not None else ""
    shown = preview(item.payload, item.payload_length_bytes, item.content_type)
    after = "  " + styled("(late)", "yellow", sys.stdout) if late else ""
    return f"{instant_text(item.time)}{duration}  {named}#{item.seq}{attributes_text(item.attributes)}  {shown}{after}"
