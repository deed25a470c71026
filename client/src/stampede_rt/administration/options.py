"""Verbs and options of `stampede supernode` that the client and a joining supernode share."""

from __future__ import annotations

import argparse

ADMINISTRATIVE_VERBS = ("status", "add", "remove", "snapshot")
"""The client runs these verbs. The supernode runs all other verbs."""


def add_cluster_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name the addresses of the cluster."""
    addresses = parser.add_mutually_exclusive_group()
    addresses.add_argument(
        "--url", "--frontend", metavar="HOST:PORT,...", help="front-ends; default $STAMPEDE_URL, then localhost:7580"
    )
    addresses.add_argument("--member", metavar="HOST:PORT,...", help="supernodes to ask instead, if no front-end runs")
