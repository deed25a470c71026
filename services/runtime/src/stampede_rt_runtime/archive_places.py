"""The places where a host keeps recorded channels: a folder, or an object store and a folder for files that have not
moved.
"""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

SCHEMES = ("s3", "gs", "az", "file")


def parse_archive(text: str) -> Path | str:
    """Return a folder, or the URL of an object store with a prefix. Raises ValueError."""
    scheme, is_url, rest = text.strip().partition("://")
    if not is_url:
        return Path(text)
    parts = urlsplit(text.strip())
    if "@" in rest or parts.query or parts.fragment:
        raise ValueError("a URL without credentials and options; these come from the environment, such as AWS_...")
    is_complete = bool(parts.path.strip("/")) if scheme == "file" else bool(parts.netloc)
    if scheme not in SCHEMES or not is_complete:
        raise ValueError(
            "a folder, or the URL of an object store: s3://BUCKET/PREFIX, gs://BUCKET/PREFIX, az://CONTAINER/PREFIX or "
            "file:///FOLDER"
        )
    return text.strip().rstrip("/")


def folder_of(archive: Path | str | None, folder: Path | None, data_dir: Path | None) -> Path | None:
    """The folder of an archive on this machine; None: there is no archive.

    `folder`: the folder that a setting names for files that have not moved to an object store, or None.
    """
    if archive is None or isinstance(archive, Path):
        return archive
    if folder is not None:
        return folder
    return default_folder() if data_dir is None else data_dir / "archive"


def default_folder() -> Path:
    """The folder `stampede/archive` below `$XDG_STATE_HOME`, or below `~/.local/state`."""
    state = os.environ.get("XDG_STATE_HOME", "")
    return (Path(state) if state else Path.home() / ".local" / "state") / "stampede" / "archive"


def check_archive(archive: Path | str | None, folder: Path | None) -> None:
    """Check that the settings of an archive fit. Raises ValueError."""
    if isinstance(archive, str) and find_spec("obstore") is None:
        raise ValueError(
            f"--archive {archive} needs the extra [objects] of stampede-rt; install it as you installed stampede-rt"
        )
    if folder is not None and not isinstance(archive, str):
        raise ValueError(
            "--archive-folder is the folder of an archive in an object store; give the URL of the store in --archive, "
            "or the folder itself in --archive"
        )
