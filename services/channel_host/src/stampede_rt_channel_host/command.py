"""The entry of `stampede host`. `--help` loads only the settings; a run loads the service, too."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_runtime.memory.huge_pages import start_again_with_huge_pages
from stampede_rt_runtime.settings import help_of


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede host`, or print its help. Returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    text = help_of(HostSettings, service="host", argv=words)
    if text is not None:
        sys.stdout.write(text)
        return 0
    start_again_with_huge_pages("host", words)
    import stampede_rt.grpc_quiet  # noqa: F401  # before the service imports gRPC
    from stampede_rt_channel_host.app import main as run

    return run(words)
