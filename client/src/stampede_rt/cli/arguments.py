"""The arguments that several verbs of the command line have in common, and their parsers."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING, Any

from stampede_rt.administration.output_forms import FORMS, add_output
from stampede_rt.cli.interrupts import interruption
from stampede_rt.errors import ChannelNotFound, InvalidArgument, StampedeError
from stampede_rt.values.timeline import NEWEST, NOW, OLDEST, Bound, parse_duration, parse_instant

if TYPE_CHECKING:
    from stampede_rt import Channel, Connection

_META = {"now": NOW, "newest": NEWEST, "oldest": OLDEST}
_META_TEXT = re.compile(r"(now|newest|oldest)\s*(?:([+-])\s*(\d.*))?")


_SECONDS = re.compile(r"\d+(\.\d*)?|\.\d+", re.ASCII)


def timeout_seconds(text: str) -> float:
    """The seconds of a duration such as "500ms", or of a bare number of seconds. Raises ArgumentTypeError."""
    try:
        return float(text) if _SECONDS.fullmatch(text) else parse_duration(text, "the time") / 1e9
    except InvalidArgument as error:
        raise argparse.ArgumentTypeError(error.message) from None


def add_verb(
    subparsers: Any, name: str, text: str, run: Callable[[argparse.Namespace], int], *, output: bool = True
) -> argparse.ArgumentParser:
    """Add a verb with the option --url, and with --output and --local unless `output` is False."""
    parser: argparse.ArgumentParser = subparsers.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    parser.add_argument(
        "--url", metavar="HOST:PORT", help="front-ends, comma-separated; default $STAMPEDE_URL, then localhost:7580"
    )
    if output:
        add_output(parser)
        _add_local(parser)
    return parser


def add_summary(parser: argparse.ArgumentParser, *flags: str) -> None:
    """Add the options --output and --local. `--summary` is the former name of --output.

    `flags`: further names of --output, such as "-o". In some verbs -o names a file, so they do not pass it here.
    """
    names = (*flags, "--output", "--summary")
    parser.add_argument(*names, choices=FORMS, default="table", help="the form of the output; default table")
    _add_local(parser)


def _add_local(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--local", action="store_true", help="print instants as local time; default: UTC")


def connected(arguments: argparse.Namespace, name: str | None = None) -> Connection:
    """Connect to the cluster that the common options name. `name`: the peer's name. Ctrl-C closes the connection."""
    from stampede_rt import connect  # gRPC takes 0.1 s to load; --help does not need it

    rt = connect(arguments.url or os.environ.get("STAMPEDE_URL"), name=name)
    interruption.add_close(rt.close)
    return rt


def existing_channel(rt: Connection, name: str) -> Channel:
    """Open an existing channel. Raises ChannelNotFound with an error text for users of the command line."""
    try:
        return rt.channel(name, create=False)
    except ChannelNotFound as error:
        raise ChannelNotFound(
            f"there is no channel {name}; `stampede ls` lists the channels, `stampede put {name}` creates it"
        ) from error


def is_glob(word: str) -> bool:
    """Whether a word is a glob: whether it contains `*` or `?`. No name contains these characters."""
    return "*" in word or "?" in word


def parse_count(text: str) -> int:
    """Return a number of items or lines, 1 or more."""
    if not re.fullmatch(r"\d{1,18}", text) or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of items or lines; write 1 or more")
    return int(text)


def checked(parse: Callable[[str], Any]) -> Callable[[str], Any]:
    """Wrap `parse` for `argparse`.

    If `parse` raises StampedeError, the wrapper raises a usage error with the reason.
    """

    def parse_or_explain(text: str) -> Any:
        try:
            return parse(text)
        except StampedeError as error:
            raise argparse.ArgumentTypeError(error.message) from None

    return parse_or_explain


def parse_time(text: str) -> int:
    """Return an instant, in nanoseconds.

    `text` is nanoseconds since the epoch, or ISO 8601. ISO 8601 without a time zone is local time.
    """
    if re.fullmatch(r"[+-]?\d{1,20}", text):
        return parse_instant(int(text))
    try:
        return parse_instant(datetime.fromisoformat(text).astimezone())
    except (ValueError, OverflowError) as error:
        if isinstance(error, InvalidArgument):
            raise
        raise InvalidArgument(
            f"{text!r} is not a time; write nanoseconds since the epoch, or ISO 8601 such as 2026-01-31T12:00:00Z or, "
            "in local time, 2026-01-31T12:00:00"
        ) from None


def parse_bound_text(text: str) -> Bound:
    """Return a bound. `text` is a time, or "now", "newest" or "oldest", also with an offset as in "newest-30ms"."""
    match = _META_TEXT.fullmatch(text.strip())
    if match is None:
        return Bound(None, parse_time(text))
    bound = _META[match[1]]
    if match[2] is None:
        return bound
    return bound + match[3] if match[2] == "+" else bound - match[3]


def parse_attribute(text: str) -> tuple[str, str]:
    """Return the key and the value of an attribute in the form KEY=VALUE. Raises InvalidArgument."""
    key, separator, value = text.partition("=")
    if not separator or not key:
        raise InvalidArgument(f"{text!r} is not an attribute; write KEY=VALUE")
    return key, value
