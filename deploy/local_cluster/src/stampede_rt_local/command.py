"""The entry of `stampede dev`. `--help` loads only the settings; a run loads the cluster, too."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from stampede_rt_local.settings import DevSettings
from stampede_rt_runtime.settings import help_of


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede dev`, or print its help. Returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    text = help_of(DevSettings, service="dev", argv=words)
    if text is not None:
        sys.stdout.write(text)
        return 0
    import stampede_rt.grpc_quiet  # noqa: F401  # before the service imports gRPC
    from stampede_rt_local.dev import main as run

    return run(words)
