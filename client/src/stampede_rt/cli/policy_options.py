"""The options for the policy of a channel."""

from __future__ import annotations

import argparse
from typing import Any

from stampede_rt.values.policy import ACKS, ON_FULL

LIMITS = (
    "max_age",
    "max_items",
    "max_bytes",
    "consumers",
    "max_age_unconsumed",
    "archive",
    "archive_bytes",
    "on_full",
    "replicas",
    "ack",
    "min_replicas",
)


def add_policy(parser: argparse.ArgumentParser) -> None:
    """Add the options of a channel's policy."""
    add_limits(parser)
    parser.add_argument(
        "--overlap",
        metavar="DURATION",
        help="an item with a duration may last for this time, even if later items come meanwhile",
    )
    parser.add_argument("--content-type", metavar="MIME", help='the MIME type of the items, such as "image/jpeg"')


def policy_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the policy as keyword arguments of `Connection.channel`."""
    return limits_of(arguments) | {"overlap": arguments.overlap, "content_type": arguments.content_type}


def limits_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of `add_limits` as keyword arguments."""
    return {name: getattr(arguments, name) for name in LIMITS}


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the options for the settings that a channel can change later."""
    parser.add_argument("--max-age", metavar="DURATION", help='keep items for this time, such as "10s"')
    parser.add_argument("--max-items", type=int, metavar="N", help="keep at most N items")
    parser.add_argument("--max-bytes", type=int, metavar="N", help="keep at most N bytes")
    parser.add_argument(
        "--consumers", type=int, metavar="N", help="an item may leave when N consumers have consumed it"
    )
    parser.add_argument(
        "--max-age-unconsumed",
        metavar="DURATION",
        help="keep items for this time while a live consumer must still consume them",
    )
    parser.add_argument(
        "--archive",
        metavar="DURATION",
        help='record the channel: the host keeps items on disk for this time, or "forever"',
    )
    parser.add_argument("--archive-bytes", metavar="SIZE", help='keep at most this size on disk, such as "200GiB"')
    parser.add_argument("--on-full", choices=ON_FULL, help="what the host does with a put into a full channel")
    parser.add_argument("--replicas", type=int, metavar="N", help="copies that can take over if the host is lost")
    parser.add_argument("--ack", choices=ACKS, help="when the host acknowledges a put")
    parser.add_argument(
        "--min-replicas",
        type=int,
        metavar="N",
        help="with --ack replica, acknowledge puts only while N replicas are in sync",
    )
