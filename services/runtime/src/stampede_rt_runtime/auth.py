"""The secrets of a cluster and of its clients: makes the file of the cluster's secret, and reads both files."""

from __future__ import annotations

import os
import secrets
from dataclasses import dataclass, field
from pathlib import Path

from stampede_rt.errors import PermissionDenied
from stampede_rt.security.credentials import read_secrets, secret_file
from stampede_rt_runtime.written import naming


@dataclass(frozen=True, kw_only=True, slots=True)
class Secret:
    """A secret and its file. Never logged: `repr` leaves the text out.

    `other`: a second accepted value, while the secret is being replaced; empty: there is none.
    """

    text: str = field(repr=False)
    path: Path
    other: str = field(default="", repr=False)

    @property
    def accepted(self) -> tuple[str, ...]:
        """The secrets that callers may bring."""
        return (self.text, self.other) if self.other else (self.text,)


def load_secret(path: Path | None) -> Secret | None:
    """The secret in `path`; `path` None: the secret in $STAMPEDE_SECRET_FILE, or in the user's default file.

    None: no file is named, and the default file does not exist. Raises PermissionDenied if the file is missing, empty,
    or may be read by others.
    """
    secret_path = path or secret_file()
    values = read_secrets(secret_path)
    if values is None:
        if path is None and "STAMPEDE_SECRET_FILE" not in os.environ:
            return None
        raise PermissionDenied(
            f"there is no secret file {secret_path}; make one with `stampede dev`, or name another file"
        )
    if not values:
        raise PermissionDenied(f"the secret file {secret_path} is empty; remove it, and `stampede dev` makes a new one")
    return Secret(text=values[0], path=secret_path, other=values[1] if len(values) > 1 else "")


def load_client_secret(path: Path | None, secret: Secret | None) -> Secret | None:
    """The clients' secret in `path`; None if `path` is None. `secret`: the secret of the cluster.

    Raises PermissionDenied as `load_secret` does, and if the two secrets are equal or the cluster has none.
    """
    if path is None:
        return None
    found = load_secret(path)
    assert found is not None, "an explicit path never gives None"
    if secret is None:
        raise PermissionDenied(
            f"the clients have a secret, {path}, but the cluster has none for its services; "
            "give the services --secret-file, too"
        )
    if set(found.accepted) & set(secret.accepted):
        raise PermissionDenied(
            f"{path} and {secret.path} hold the same value, so each of its callers would count as a service of the "
            "cluster; make another one for the clients"
        )
    return found


def make_secret_file(path: Path | None = None) -> Secret:
    """The secret in `path` (default: the user's file). Makes the file first if it does not exist.

    The file appears whole, with mode 0600, or not at all. If several processes make the file at the same time, one
    succeeds, and all return its secret. Raises PermissionDenied if the file is empty or may be read by others, OSError
    if it cannot be written.
    """
    secret_path = path or secret_file()
    if not secret_path.exists():
        _create(secret_path)
    found = load_secret(secret_path)
    assert found is not None, "an explicit path never gives None"
    return found


def _create(secret_path: Path) -> None:
    secret_path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    draft = secret_path.with_name(f".{secret_path.name}.{secrets.token_hex(8)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with naming(secret_path), os.fdopen(descriptor, "w") as file:
            file.write(secrets.token_urlsafe(32) + "\n")
        os.link(draft, secret_path)  # unlike rename, link never replaces a file: the file of the first process stays
    except FileExistsError:
        pass  # another process has made the file meanwhile, and its secret counts
    finally:
        draft.unlink()
