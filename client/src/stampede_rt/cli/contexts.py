"""Saved contexts: the address of a cluster and the files of its credentials, by a name.

The file `stampede/contexts.json` below `$XDG_CONFIG_HOME` (default `~/.config`) has them, and only its owner may read
it. A context names the files of secrets and keys. A secret that `stampede context add` reads from standard input goes
into a file of its own in the same folder. Nothing here prints a secret.
"""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt.security.credentials import user_folder

VARIABLES = {
    "url": "STAMPEDE_URL",
    "secret_file": "STAMPEDE_SECRET_FILE",
    "tls_ca": "STAMPEDE_TLS_CA",
    "tls_certificate": "STAMPEDE_TLS_CERTIFICATE",
    "tls_key": "STAMPEDE_TLS_KEY",
}
"""The fields of a context, each with the variable of the environment that it sets."""
CHOICE = "STAMPEDE_CONTEXT"  # names the context for one command
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
FILE_BYTES_MAX = 1024 * 1024


class Contexts:
    """All saved contexts. `current`: the name of the context that commands use; None: they use none."""

    def __init__(self, folder: Path, saved: Mapping[str, Any]) -> None:
        self.folder = folder
        self.current: str | None = saved.get("current")
        self.by_name: dict[str, dict[str, str]] = dict(saved.get("contexts", {}))

    @classmethod
    def load(cls, environ: Mapping[str, str]) -> Contexts:
        """Read the file of this user. Raises PermissionDenied if others may read it, InvalidArgument if it is wrong."""
        path = user_folder(environ) / "contexts.json"
        try:
            with path.open("rb") as file:
                mode = os.fstat(file.fileno()).st_mode
                text = file.read(FILE_BYTES_MAX + 1)
        except FileNotFoundError:
            return cls(path.parent, {})
        except OSError as error:
            raise PermissionDenied(f"the contexts in {path} cannot be read: {error.strerror}") from error
        if stat.S_IMODE(mode) & 0o077:
            raise PermissionDenied(f"other users may use the contexts in {path}; run: chmod 600 {path}")
        return cls(path.parent, _checked(path, text))

    def named(self, name: str) -> dict[str, str]:
        """Return a context. Raises InvalidArgument if there is none of that name."""
        if name not in self.by_name:
            known = ", ".join(sorted(self.by_name)) or "none"
            raise InvalidArgument(
                f"there is no context {name!r}; the saved ones: {known}; `stampede context add` adds one"
            )
        return self.by_name[name]

    def save(self) -> None:
        """Write the file, as a whole or not at all, so that only its owner may read it."""
        text = json.dumps({"current": self.current, "contexts": self.by_name}, indent=2) + "\n"
        write_private(self.folder / "contexts.json", text.encode())

    def secret_path(self, name: str) -> Path:
        """The file for a secret that a context got from standard input."""
        return self.folder / f"context-{name}.secret"


def _checked(path: Path, text: bytes) -> Mapping[str, Any]:
    """Return the content of the file. Raises InvalidArgument, which says what is wrong in it."""
    saved: Any = None
    if len(text) <= FILE_BYTES_MAX:
        with suppress(ValueError, RecursionError):
            saved = json.loads(text)
    if why := _fault(saved):
        raise InvalidArgument(f"the contexts in {path} are damaged: {why}; correct the file, or delete it")
    return saved  # type: ignore[no-any-return]  # `_fault` has looked


def _fault(saved: Any) -> str:
    """Return what is wrong in the content of the file; "" if nothing is."""
    if not isinstance(saved, dict):
        return f"it is no JSON object of at most {FILE_BYTES_MAX} bytes"
    if set(saved) != {"current", "contexts"} or not isinstance(saved["contexts"], dict):
        return 'it needs "current" and "contexts", and nothing else; "contexts" is an object'
    for name, fields in saved["contexts"].items():
        if why := _fault_of(name, fields):
            return f"context {name!r} {why}"
    current = saved["current"]
    if current is not None and not (isinstance(current, str) and current in saved["contexts"]):
        return f'"current" is {current!r}, which is not a context in it'
    return ""


def _fault_of(name: str, fields: Any) -> str:
    if not NAME.fullmatch(name):
        return "has a name that is not allowed"
    if not isinstance(fields, dict) or not fields.get("url"):
        return 'has no "url"'
    if unknown := set(fields) - set(VARIABLES):
        return f"has the unknown field {min(unknown)!r}; allowed are {', '.join(VARIABLES)}"
    if wrong := [field for field, value in fields.items() if not _is_text(value)]:
        return f"has no text in {wrong[0]!r}"
    return ""


def _is_text(value: Any) -> bool:
    """Whether a value can go into a variable of the environment."""
    return isinstance(value, str) and value.isprintable()


def write_private(path: Path, data: bytes) -> None:
    """Write a file that only its owner may read, as a whole or not at all. Raises PermissionDenied."""
    import tempfile  # it loads many modules, and most commands write nothing

    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        descriptor, made = tempfile.mkstemp(dir=path.parent, prefix=".stampede-")  # mode 0600
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
            os.replace(made, path)
        except BaseException:
            os.unlink(made)
            raise
    except OSError as error:
        raise PermissionDenied(f"{path} cannot be written: {error.strerror}") from error


@contextmanager
def context_applied(environ: MutableMapping[str, str], *, has_url: bool) -> Iterator[None]:
    """Put the fields of the chosen context into the environment of this process, for the duration of the block.

    `$STAMPEDE_CONTEXT` names the context of one command. Its fields override other variables. Without
    `$STAMPEDE_CONTEXT` the function takes the context of `stampede context use`, and variables of the environment
    override its fields. A command that states an address (`has_url`, or `$STAMPEDE_URL`) uses no context, so that no
    cluster gets the secret of another cluster. Raises InvalidArgument if there is no context of that name.
    """
    before = {variable: environ.get(variable) for variable in VARIABLES.values()}
    for variable, value in _chosen(environ, has_url).items():
        environ[variable] = value
    try:
        yield
    finally:
        for variable, former in before.items():
            environ.pop(variable, None)
            if former is not None:
                environ[variable] = former


def _chosen(environ: Mapping[str, str], has_url: bool) -> dict[str, str]:
    """Return the variables that the chosen context sets."""
    by_variable = environ.get(CHOICE)
    if has_url or (environ.get("STAMPEDE_URL") and not by_variable):
        return {}
    contexts = Contexts.load(environ)
    name = by_variable or contexts.current
    fields = contexts.named(name) if name else {}
    return {
        VARIABLES[field]: value for field, value in fields.items() if by_variable or not environ.get(VARIABLES[field])
    }
