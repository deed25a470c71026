"""`stampede replay` and `stampede import`: they put the items of files, or of other channels, into channels."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_summary, add_verb, checked, connected, parse_time
from stampede_rt.cli.exit_statuses import INCOMPLETE
from stampede_rt.cli.held_items import file_with_items_of
from stampede_rt.cli.interrupts import interruption
from stampede_rt.cli.output import joined, print_document, print_rows
from stampede_rt.cli.progress import shown_progress
from stampede_rt.cli.record import GAPS_SHOWN, gap_text
from stampede_rt.escaping import escaped
from stampede_rt.values.recording import ReplaySummary

if TYPE_CHECKING:
    from stampede_rt._sync.player import Player

STOP_S = 5.0  # after Ctrl-C the command waits at most this time for the hosts to acknowledge the last items


def add_verbs(subparsers: Any) -> None:
    """Add the verbs of this module."""
    replay = add_verb(subparsers, "replay", "play an MCAP file, or channels, into channels", run_replay, output=False)
    replay.add_argument(
        "sources", nargs="+", metavar="SOURCE", help="one MCAP file, or channels or globs such as 'rig/*'"
    )
    replay.add_argument(
        "--as",
        dest="prefix",
        default="replay/",
        metavar="PREFIX",
        help='the beginning of the names of the channels; default "replay/"',
    )
    replay.add_argument(
        "--speed", type=_speed, default=1.0, metavar="N", help='such as 2 or 0.5; "max" is without pauses; default 1'
    )
    replay.add_argument("--loop", action="store_true", help="play again and again, until Ctrl-C; needs '--shift now'")
    importing = add_verb(subparsers, "import", "put the items of a file into channels", run_import, output=False)
    importing.add_argument("path", metavar="FILE", help="MCAP, rosbag2 (its folder, or a file in it), or XDF")
    importing.add_argument(
        "--as", dest="prefix", default="", metavar="PREFIX", help="the beginning of the names of the channels"
    )
    for verb in (replay, importing):
        verb.add_argument("--from", dest="start", type=checked(parse_time), metavar="TIME", help="the earliest time")
        verb.add_argument(
            "--to", dest="end", type=checked(parse_time), metavar="TIME", help="the end of the times, exclusive"
        )
        verb.add_argument(
            "--channel", action="append", metavar="GLOB", help="a name, or a glob such as 'rig/*'; may be repeated"
        )
        verb.add_argument(
            "--shift",
            metavar="SHIFT",
            help='move all times to "now", or by a duration such as -1h; default: the recorded times',
        )
        add_summary(verb, "-o")


def _speed(text: str) -> float:
    if text == "max":
        return 0.0
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed <= 1e6:
        raise argparse.ArgumentTypeError(f'{text!r} is not a speed; write a number such as 2 or 0.5, or "max"')
    return speed


def run_replay(arguments: argparse.Namespace) -> int:
    """Play a file or channels, and print the numbers of items put. The status is 3 if anything is missing."""
    sources = arguments.sources
    with file_with_items_of(arguments, sources, from_start=True) as (path, copy_status), connected(arguments) as rt:
        player = rt.replay_file(
            path,
            arguments.prefix,
            channels=arguments.channel or "*",
            speed=arguments.speed,
            start=arguments.start,
            end=arguments.end,
            loop=arguments.loop,
            shift=arguments.shift,
        )
        # Each status is 0 or INCOMPLETE, which is greater.
        return max(copy_status, _played(player, arguments, " ".join(sources)))


def run_import(arguments: argparse.Namespace) -> int:
    """Import a file, and print the numbers of items put. The status is 3 if anything is missing."""
    with connected(arguments) as rt:
        player = rt.import_file(
            arguments.path,
            arguments.prefix,
            channels=arguments.channel or "*",
            start=arguments.start,
            end=arguments.end,
            shift=arguments.shift,
        )
        return _played(player, arguments, arguments.path)


def _played(player: Player, arguments: argparse.Namespace, source: str) -> int:
    interruption.set_regular_end(player.stop, STOP_S)
    names = player.channels
    shown = escaped(joined(names)) if len(names) <= 5 else f"{len(names)} channels"
    print(f"stampede: putting {escaped(source)} into {shown}", file=sys.stderr)
    with shown_progress(lambda: (player.done_share, f"{player.accepted} items put")):
        summary = player.wait()
    assert summary is not None, "`wait` without a timeout returns the summary"
    _print(summary, source, arguments.output)
    return 0 if summary.complete else INCOMPLETE


def _print(summary: ReplaySummary, source: str, output_format: str) -> None:
    if output_format != "table":
        value = {
            "file": source,
            "complete": summary.complete,
            "items": dict(summary.items),
            "refused": summary.refused,
            "first_refusal": summary.first_refusal,
            "advances": summary.advances,
            "rounds": summary.rounds,
            "collected": dict(summary.collected),
            "gaps": [gap.to_json() for gap in summary.gaps],
            "damaged": list(summary.damaged),
        }
        print_document(value, output_format)
        return
    rows = [{"channel": name, "items": items} for name, items in sorted(summary.items.items())]
    print_rows(rows, "table", none="no channels")
    for gap in summary.gaps[:GAPS_SHOWN]:
        print(f"missing in the file: {gap_text(gap)}")
    if len(summary.gaps) > GAPS_SHOWN:
        print(f"missing in the file: {len(summary.gaps) - GAPS_SHOWN} more gaps")
    for text in summary.damaged:
        print(f"missing in the file: {escaped(text)}")
    for name, count in sorted(summary.collected.items()):
        print(f"missing: channel {escaped(name)} has removed {count} items, as its policy demands; change the policy")
    if summary.first_refusal:
        print(f"refused: {summary.refused} items and advances; the first: {escaped(summary.first_refusal)}")
