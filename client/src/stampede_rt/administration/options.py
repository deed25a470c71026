"""The words of `stampede supernode` that the client and a supernode that joins share."""

from __future__ import annotations

import argparse

ADMINISTRATIVE_VERBS = ("status", "add", "remove", "snapshot")
"""The client runs these. All other words are the supernode's own."""


def add_cluster_options(parser: argparse.ArgumentParser) -> None:
    """The options that say where the cluster is."""
    addresses = parser.add_mutually_exclusive_group()
    addresses.add_argument("--url", "--frontend", metavar="HOST:PORT,...", help="front-ends; default $STAMPEDE_URL")
    addresses.add_argument("--member", metavar="HOST:PORT,...", help="supernodes, if no front-end runs")
