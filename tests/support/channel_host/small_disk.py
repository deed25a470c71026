"""A disk of a few MiB for tests: a tmpfs."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class NoSmallDisk(Exception):
    """This process may not mount a tmpfs."""


@contextmanager
def small_disk(folder: Path, size_bytes: int) -> Iterator[Path]:
    """Mount a tmpfs of this size at `folder`. Raises NoSmallDisk."""
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size_bytes}", "archive", folder]
    if os.geteuid() or subprocess.run(mount, check=False, capture_output=True).returncode:
        raise NoSmallDisk("a small disk needs root, and the right to mount a tmpfs")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=False)
