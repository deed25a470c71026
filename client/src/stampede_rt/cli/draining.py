"""`stampede host drain`: moves all channels of a host to other hosts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from stampede_rt.cli.arguments import add_verb, connected
from stampede_rt.cli.output import print_facts, print_rows
from stampede_rt.cli.progress import Progress, shown_progress
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.escaping import TerminalParser, escaped

if TYPE_CHECKING:
    from stampede_rt import Connection


def drain(words: Sequence[str]) -> int:
    """Run `stampede host drain`. Returns 1 if a channel has not moved."""
    parser = TerminalParser(prog="stampede host", description=__doc__)
    verbs = parser.add_subparsers(dest="host_verb", metavar="VERB", required=True, parser_class=VerbParser)
    verb = add_verb(verbs, "drain", "move all channels of a host to other hosts, while they are in use", lambda _: 0)
    verb.add_argument("host", metavar="HOST", help="the host's name")
    verb.add_argument(
        "--timeout", default="60s", metavar="DURATION", help="give up after this time, at most 60s; default: 60s"
    )
    arguments = parser.parse_args(words)
    with connected(arguments) as rt, shown_progress(_progress(rt, arguments.host)):
        drained = rt.drain(arguments.host, timeout=arguments.timeout)
    if arguments.output != "table":
        print_facts({"host": drained.host, "moved": drained.moved, "left": dict(drained.left)}, arguments.output)
    else:
        rows = [{"channel": name, "not moved because": reason} for name, reason in drained.left.items()]
        moved = f"channels, queues and mailboxes that have moved away from {drained.host}: {drained.moved}"
        print_rows(rows, arguments.output, none=moved)
    return 1 if drained.left_count else 0


def _progress(rt: Connection, host: str) -> Callable[[], Progress]:
    """Return the function that tells how many channels have left the host, according to the directory."""
    all_channels = 0

    def look() -> Progress:
        nonlocal all_channels
        left = next((one.channels for one in rt.hosts() if one.name == host), 0)
        all_channels = max(all_channels, left)
        share = (all_channels - left) / all_channels if all_channels else None
        return share, f"{all_channels - left} of {all_channels} channels have moved away from {escaped(host)}"

    return look
