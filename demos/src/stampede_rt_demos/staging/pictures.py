"""Checks the path of a demo's picture."""

from __future__ import annotations

import os
from pathlib import Path

from stampede_rt_demos.failures import DemoFailed


def require_writable(picture: Path) -> None:
    """Make the folder of the picture, but no file yet. Raises DemoFailed if no file can be made there."""
    try:
        picture.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DemoFailed(f"the folder of the picture {picture} cannot be made: {error.strerror}") from error
    target = picture if picture.exists() else picture.parent
    if picture.is_dir() or not os.access(target, os.W_OK):
        raise DemoFailed(f"the picture cannot be written to {picture}; name a file in a folder of yours")
