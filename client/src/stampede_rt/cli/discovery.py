"""`stampede ls` and `stampede info`: channels and their counters."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.archive_facts import archive_facts
from stampede_rt.cli.arguments import add_verb, connected, existing_channel
from stampede_rt.cli.channel_users import user_facts
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import bytes_text, policy_text, print_facts, print_rows
from stampede_rt.cli.replicas import replica_rows, replicas_text
from stampede_rt.values.model import ChannelInfo
from stampede_rt.values.proxying import ProxyInfo
from stampede_rt.values.statistics import ChannelMulticastStats, ChannelStats
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import Connection


def add_verbs(subparsers: Any) -> None:
    """Add the verbs of this module."""
    ls = add_verb(subparsers, "ls", "list channels", run_ls)
    ls.add_argument("glob", nargs="?", default="*", metavar="GLOB", help='names, such as "cam/*"')
    ls.add_argument("-l", "--long", action="store_true", help="also print counters, which the hosts give")
    info = add_verb(subparsers, "info", "print a channel's policy and counters", run_info)
    info.add_argument("channel", help="the channel's name")


def run_ls(arguments: argparse.Namespace) -> int:
    """List channels from the directory."""
    with connected(arguments) as rt:
        channels = rt.channels(arguments.glob)
        rows = [_row(channel, arguments.output) for channel in channels]
        if arguments.long:
            _add_counters(rt, arguments.glob, channels, rows, arguments.output)
    print_rows(rows, arguments.output, none=f"no channel matches {arguments.glob!r}")
    return 0


def _row(channel: ChannelInfo, output_format: str) -> dict[str, Any]:
    return {
        "channel": channel.name,
        "host": channel.host if channel.host_alive or output_format != "table" else f"{channel.host} (lost)",
        "keeps": policy_text(channel.policy),
        "content_type": channel.policy.content_type,
        "epoch": channel.epoch,
    }


def _add_counters(
    rt: Connection, glob: str, channels: list[ChannelInfo], rows: list[dict[str, Any]], output_format: str
) -> None:
    hosts = {channel.host for channel in channels if channel.host_alive}
    stats = {(name, host): one for host in hosts for name, one in rt.hosted_channels(host, glob).items()}
    for row, channel in zip(rows, channels, strict=True):
        row["created_by"] = channel.created_by or None
        one = stats.get((channel.name, channel.host))
        held_bytes = one.held_bytes if one else None
        row["held"] = one.held if one else None
        row["held_bytes"] = (
            bytes_text(held_bytes) if output_format == "table" and held_bytes is not None else held_bytes
        )
        row["accepted"] = one.accepted if one else None


def run_info(arguments: argparse.Namespace) -> int:
    """Print a channel's policy and counters."""
    with connected(arguments) as rt:
        channel = existing_channel(rt, arguments.channel)
        stats = channel.stats()
        info = channel.info
        proxies = rt.proxies(channel) if stats.copies else []
        replicas = replica_rows(rt, stats.copies) if stats.policy.replicas else []
    for_people = arguments.output == "table"
    instant = instant_text if for_people else (lambda value: value)
    facts: dict[str, Any] = {
        "channel": info.name,
        "host": info.host,
        "created_by": info.created_by or None,
        "epoch": info.epoch,
        "incarnation": f"{stats.incarnation:016x}",
        "keeps": policy_text(stats.policy),
        "on_full": stats.policy.on_full or "drop_oldest",
        "held": stats.held,
        "held_bytes": bytes_text(stats.held_bytes) if for_people else stats.held_bytes,
        "accepted": stats.accepted,
        "collected": _counts(stats.collected) if for_people else dict(stats.collected),
        "rejected": _counts(stats.rejected) if for_people else dict(stats.rejected),
        "oldest": None if stats.oldest is None else instant(stats.oldest),
        "newest": None if stats.newest is None else instant(stats.newest),
        "age": _age(stats.newest, stats.host_time, for_people),
        "frontier": None if stats.frontier is None else instant(stats.frontier),
        **archive_facts(stats, for_people),
        "consumers": _consumers(stats) if for_people else [asdict(one) for one in stats.consumers],
        "subscriptions": stats.subscriptions,
        **user_facts(stats, for_people),
        "waiting_gets": stats.waiting_gets,
        "waiting_puts": stats.waiting_puts,
        "clock_offset": format_duration(stats.clock_offset_nanos or 0) if for_people else stats.clock_offset_nanos,
        "transport": stats.transport,
        "replicas": _replicas_text(stats, replicas) if for_people else replicas,
        "multicast": _multicast(stats.multicast, for_people),
        "proxies": _proxies(proxies) if for_people else [asdict(one) for one in proxies],
    }
    print_facts(facts, arguments.output)
    return 0


def _counts(counts: Any) -> str:
    shown = [f"{count} by {cause.replace('_', ' ')}" for cause, count in counts.items() if count]
    return ", ".join(shown) or "none"


def _consumers(stats: ChannelStats) -> str:
    """Return the consumer places as a text for people, without the ids, which are for programs."""
    if not stats.consumers and stats.policy.consumers is None:
        return "none"
    held = [f"{one.waiting} waiting" if one.lease_nanos else "lease ended" for one in stats.consumers]
    of = "" if stats.policy.consumers is None else f" of {stats.policy.consumers}"
    return f"{len(stats.consumers)}{of} taken" + (f" ({', '.join(held)})" if held else "")


def _replicas_text(stats: ChannelStats, replicas: list[dict[str, Any]]) -> str:
    if not stats.policy.replicas:
        return "none"
    lacking = f", {stats.not_replicated} items not replicated in time" if stats.not_replicated else ""
    before = stats.inherited_next_seq
    lost = f"; after the loss of a host a replica went on at seq {before}" if before else ""
    return replicas_text(stats.policy.replicas, replicas) + lacking + lost


def _multicast(sent: ChannelMulticastStats | None, for_people: bool) -> Any:
    if not for_people:
        return {} if sent is None else asdict(sent)
    if sent is None:
        return "none"
    return f"{sent.readers} readers at {sent.group} ({sent.datagrams} datagrams sent, {sent.repairs} repairs)"


def _proxies(proxies: list[ProxyInfo]) -> str:
    shown = [
        f"{one.host} (lag at most {format_duration(one.staleness_nanos)}, {one.subscriptions} subscriptions)"
        if one.ready and one.staleness_nanos is not None
        else f"{one.host} (not ready)"
        for one in proxies
    ]
    return ", ".join(shown) or "none"


def _age(newest: int | None, host_time: int, for_people: bool) -> str | int | None:
    if newest is None:
        return None
    return format_duration(host_time - newest) if for_people else host_time - newest
