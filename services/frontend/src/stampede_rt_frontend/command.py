"""The entry of `stampede frontend`. `--help` loads only the settings; a run loads the service, too."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from stampede_rt_frontend.settings import FrontendSettings
from stampede_rt_runtime.settings import help_of


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede frontend`, or print its help. Returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    text = help_of(FrontendSettings, service="frontend", argv=words)
    if text is not None:
        sys.stdout.write(text)
        return 0
    import stampede_rt.grpc_quiet  # noqa: F401  # before the service imports gRPC
    from stampede_rt_frontend.app import main as run

    return run(words)
