"""`stampede proxy add|rm|ls`: read-only copies of channels at other hosts."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from stampede_rt.cli.arguments import add_verb, connected, existing_channel
from stampede_rt.cli.output import print_done, print_facts, print_rows
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.values.proxying import ProxyInfo
from stampede_rt.values.timeline import format_duration


def add_verbs(subparsers: Any) -> None:
    """Add the noun of this module and its verbs."""
    text = "proxies: read-only copies of channels at other hosts, which serve readers"
    noun = subparsers.add_parser("proxy", help=text, description=text)
    verbs = noun.add_subparsers(dest="proxy_verb", metavar="VERB", required=True, parser_class=VerbParser)
    add = add_verb(verbs, "add", "add a proxy, and wait until it serves readers", run_add)
    add.add_argument("channel", help="the channel's name")
    add.add_argument("host", nargs="?", metavar="HOST", help="the host of the proxy; default: the least loaded host")
    add.add_argument(
        "--source", metavar="HOST", help="the host that feeds the proxy; default: the owner of the channel"
    )
    rm = add_verb(verbs, "rm", "remove a proxy; its readers continue at another host", run_rm)
    rm.add_argument("channel", help="the channel's name")
    rm.add_argument("host", metavar="HOST", help="the proxy's host")
    ls = add_verb(verbs, "ls", "list the proxies of a channel, and how far each lags behind", run_ls)
    ls.add_argument("channel", help="the channel's name")


def run_add(arguments: argparse.Namespace) -> int:
    """Add a proxy."""
    with connected(arguments) as rt:
        proxy = rt.proxy(existing_channel(rt, arguments.channel), arguments.host, source=arguments.source)
    print_facts(proxy_row(proxy, arguments.output), arguments.output)
    return 0


def run_rm(arguments: argparse.Namespace) -> int:
    """Remove a proxy."""
    with connected(arguments) as rt:
        rt.remove_proxy(existing_channel(rt, arguments.channel), arguments.host)
    done = {"channel": arguments.channel, "host": arguments.host, "removed": True}
    print_done(done, f"{arguments.host} no longer has a proxy of {arguments.channel}", arguments.output)
    return 0


def run_ls(arguments: argparse.Namespace) -> int:
    """List the proxies of a channel."""
    with connected(arguments) as rt:
        proxies = rt.proxies(existing_channel(rt, arguments.channel))
    rows = [proxy_row(proxy, arguments.output) for proxy in proxies]
    print_rows(rows, arguments.output, none=f"channel {arguments.channel} has no proxies")
    return 0


def proxy_row(proxy: ProxyInfo, output_format: str) -> dict[str, Any]:
    """Return a proxy as facts to print, for people or for programs."""
    facts = asdict(proxy)
    if output_format == "table":
        lag = facts.pop("staleness_nanos")
        facts["lag"] = None if lag is None else f"at most {format_duration(lag)}"
    return facts
