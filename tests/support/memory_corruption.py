"""A supernode in whose memory a bit flips. Its state then differs from the others', and its log does not show why.

`python -m tests.support.memory_corruption ARGUMENTS` is `stampede supernode ARGUMENTS`. If the file FLIP_FILE is in the
data folder, the bit flips when a channel with a name that begins with CORRUPTED_PREFIX is opened. The bit is a part of
the channel's incarnation. The result of the next command about that channel shows it.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

from stampede_rt_supernode.replica import DirectoryReplica

CORRUPTED_PREFIX, FLIP_FILE = "corrupted/", "flip"


class CorruptedReplica(DirectoryReplica):
    """The directory of such a supernode. `flag`: whether the bit flips."""

    flag: Path

    def apply(self, index: int, command: bytes) -> bytes:
        """Apply the command as every supernode does; then flip the bit."""
        known = set(self._directory.tables.channels)
        result = super().apply(index, command)
        if self.flag.exists():
            channels = self._directory.tables.channels
            for channel_id in channels.keys() - known:
                if channels[channel_id].name.startswith(CORRUPTED_PREFIX):
                    channels[channel_id] = replace(
                        channels[channel_id], incarnation=channels[channel_id].incarnation ^ 1
                    )
        return result


def main() -> int:
    """Run the supernode. Returns its exit code."""
    from stampede_rt_supernode import app

    CorruptedReplica.flag = Path(sys.argv[sys.argv.index("--data-dir") + 1]) / FLIP_FILE
    with mock.patch.object(app, "DirectoryReplica", CorruptedReplica):
        return app.main()


if __name__ == "__main__":
    sys.exit(main())
