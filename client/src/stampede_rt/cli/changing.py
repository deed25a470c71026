"""`stampede rm` and `stampede configure`: they delete channels, and change the policies of channels."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, connected, existing_channel, is_glob
from stampede_rt.cli.exit_statuses import FAILED
from stampede_rt.cli.output import number_of, policy_text, print_facts, print_rows
from stampede_rt.cli.policy_options import add_limits, limits_of
from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.escaping import escaped

if TYPE_CHECKING:
    from stampede_rt import Connection


def add_verbs(subparsers: Any) -> None:
    """Add the verbs of this module."""
    rm = add_verb(subparsers, "rm", "delete channels with all their items, for everyone", run_rm)
    rm.add_argument("channels", nargs="+", metavar="CHANNEL", help="a name, or a glob such as 'test/*' with --yes")
    rm.add_argument("--yes", action="store_true", help="delete all channels that match a glob")
    configure = add_verb(subparsers, "configure", "change a channel's policy, while it is in use", run_configure)
    configure.add_argument("channel", help="the channel's name")
    add_limits(configure)
    configure.add_argument(
        "--max-future", metavar="DURATION", help="refuse items that are further in the future than this"
    )


def run_rm(arguments: argparse.Namespace) -> int:
    """Delete channels. Go on after a channel that cannot be deleted, and return FAILED at the end."""
    with connected(arguments) as rt:
        chosen = _chosen(rt, arguments.channels, arguments.yes)
        deleted = [name for name in chosen if _is_deleted(rt, name)]
    if arguments.output == "table":
        sys.stdout.writelines(f"{name} is deleted\n" for name in deleted)
    else:
        print_rows([{"channel": name, "deleted": True} for name in deleted], arguments.output, none="")
    return 0 if deleted == chosen else FAILED


def _is_deleted(rt: Connection, name: str) -> bool:
    """Delete a channel. If that fails, say why, and return False."""
    try:
        existing_channel(rt, name).delete()
    except StampedeError as error:
        print(f"stampede: {escaped(error.message)}", file=sys.stderr)
        return False
    return True


def _chosen(rt: Connection, words: list[str], yes: bool) -> list[str]:
    """Return the names to delete, each once. Raises InvalidArgument for a glob without `yes`, before any deletion."""
    names: list[str] = []
    for word in words:
        names += _matching(rt, word, yes) if is_glob(word) else [word]
    return list(dict.fromkeys(names))


def _matching(rt: Connection, glob: str, yes: bool) -> list[str]:
    found = [channel.name for channel in rt.channels(glob)]
    if not found:
        raise InvalidArgument(f"no channel matches {glob!r}; nothing is deleted")
    if not yes:
        shown = ", ".join(found[:3]) + (", ..." if len(found) > 3 else "")
        raise InvalidArgument(
            f"{glob!r} matches {number_of(len(found), 'channel')} ({shown}); nothing is deleted; --yes deletes them"
        )
    return found


def run_configure(arguments: argparse.Namespace) -> int:
    """Change the stated settings, and print the policy after the change."""
    stated = limits_of(arguments) | {"max_future": arguments.max_future}
    if all(value is None for value in stated.values()):
        raise InvalidArgument("state at least one setting, such as --max-age 30s; see stampede configure --help")
    with connected(arguments) as rt:
        policy = existing_channel(rt, arguments.channel).configure(**stated)
    if arguments.output == "table":
        print_facts({"channel": arguments.channel, "keeps": policy_text(policy)}, "table")
    else:
        print_facts({"channel": arguments.channel} | asdict(policy), arguments.output)
    return 0
