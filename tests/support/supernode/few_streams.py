"""A supernode whose port serves fewer streams, so that a test fills it sooner.

`python -m tests.support.supernode.few_streams ARGUMENTS` is `stampede supernode ARGUMENTS`.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from unittest import mock

from stampede_rt_runtime.limits import CONTROL_LIMITS

LIMITS = replace(CONTROL_LIMITS, streams_max=192, concurrent_rpcs_max=704, calls_per_connection_max=128)
"""The port still serves more streams than one connection carries, and as many other calls as any port."""


def main() -> int:
    """Run the supernode. Returns its exit code."""
    from stampede_rt_supernode import app

    with mock.patch.object(app, "CONTROL_LIMITS", LIMITS):
        return app.main()


if __name__ == "__main__":
    sys.exit(main())
