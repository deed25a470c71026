"""Simulates a release of the supernode without rules of access, made from the present code.

This release knows only feature level 1, no commands of higher levels, and no AccessService. As a program, `python -m
tests.support.earlier_release ARGUMENTS` is `stampede supernode ARGUMENTS` of that release.
"""

from __future__ import annotations

import sys
from unittest import mock

from stampede_rt_supernode.codecs.command_codec import kind_in, level_needed
from stampede_rt_supernode.core.cluster.feature_levels import OWNERS_LEVEL
from stampede_rt_supernode.replica import DirectoryReplica

EARLIER_LEVEL = OWNERS_LEVEL - 1


def earlier_kind_in(encoded: bytes) -> str:
    """Return the kind of a command as the earlier release names it; empty if that release does not know the kind."""
    kind = kind_in(encoded)
    return kind if kind and level_needed(kind) <= EARLIER_LEVEL else ""


class EarlierReplica(DirectoryReplica):
    """The directory of the earlier release."""

    highest_level = EARLIER_LEVEL
    kind_in = staticmethod(earlier_kind_in)


def main() -> int:
    """Run `stampede supernode` of the earlier release; returns the exit code."""
    with (
        mock.patch("stampede_rt_supernode.app.DirectoryReplica", EarlierReplica),
        mock.patch("stampede_rt_supernode.joining.preparing.DirectoryReplica", EarlierReplica),
        mock.patch("stampede_rt_supernode.joining.join_requests.HIGHEST_LEVEL", EARLIER_LEVEL),
        mock.patch("stampede_rt_supernode.app.access_service_pb2_grpc"),
    ):
        from stampede_rt_supernode.app import main as run

        return run()


if __name__ == "__main__":
    sys.exit(main())
