"""The settings and credentials of a host inside a program, from the arguments of `stampede_rt.host`."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from stampede_rt.cluster.connecting import Target
from stampede_rt.cluster.embedding import HostOptions
from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt.security.credentials import Credentials, SecretReader
from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_runtime.access.tokens import is_token
from stampede_rt_runtime.archive_places import parse_archive
from stampede_rt_runtime.auth import Secret, load_secret
from stampede_rt_runtime.dial import Dialer
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.listen import AddressNotAllowed, CannotListen
from stampede_rt_runtime.settings import SettingsError, unusable
from stampede_rt_runtime.tls import load_tls
from stampede_rt_runtime.values import parse_address_text, parse_target

Value = TypeVar("Value")
MISUSES = (CannotListen, AddressNotAllowed, SettingsError, ValueError)
"""The errors of a host that cannot start with its arguments."""
_FLAG = re.compile(r"--[a-z][a-z-]*(?: and the others)?")
_ARGUMENTS = {
    "--advertise": "advertise",
    "--allow-insecure-anywhere": "allow_insecure_anywhere=True",
    "--archive": "archive",
    "--archive-bytes-max": "max_archive",
    "--archive-folder": "archive_folder",
    "--listen": "listen",
    "--memory-bytes-max": "max_memory",
    "--name": "name",
    "--tls-ca and the others": "tls",
}


def settings_of(target: Target, options: HostOptions) -> HostSettings:
    """The settings of the host. Raises InvalidArgument."""
    try:
        return HostSettings(
            listen=_read("listen", options.listen, parse_address_text) or "",
            advertise=_read("advertise", options.advertise, parse_target) or "",
            name=target.name,
            frontend=target.frontends,
            zone=target.zone,
            memory_bytes_max=options.memory_bytes_max,
            allow_insecure_anywhere=options.allow_insecure_anywhere,
            private=options.private,
            archive=_read("archive", options.archive, _archive_of),
            archive_folder=_folder_of(options.archive_folder) if options.archive_folder else None,
            archive_bytes_max=options.archive_bytes_max,
        )
    except (SettingsError, ValueError) as error:
        raise cannot_host(error) from error


def _read(name: str, text: str, parse: Callable[[str], Value]) -> Value | None:
    """The value of an argument; None: it is empty. Raises SettingsError."""
    try:
        return parse(text) if text else None
    except ValueError as error:
        raise unusable(name, text, error) from None


def _archive_of(text: str) -> Path | str:
    """The place of an archive: a folder, or a URL. Raises ValueError."""
    place = parse_archive(text)
    return place if isinstance(place, str) else _folder_of(text)


def _folder_of(text: str) -> Path:
    """A folder, which stays the same if the program changes its working folder later."""
    return Path(text).expanduser().absolute()


def cannot_host(error: Exception) -> InvalidArgument:
    """The error for the caller of `stampede_rt.host`. It names the arguments instead of the flags of `stampede host`.

    Flags of other commands, and flags for which `stampede_rt.host` has no argument, stay.
    """
    text = _FLAG.sub(lambda found: _ARGUMENTS.get(found[0], found[0]), str(error))
    return InvalidArgument(f"this process cannot host channels: {text}")


def credentials_of(given: Credentials) -> Dialer:
    """The credentials of a host, from the credentials of the program. Raises PermissionDenied."""
    secret = given.secret
    if isinstance(secret, SecretReader):
        found = load_secret(secret.path) if secret.current() else None
    else:
        found = Secret(text=secret, path=Path("the argument `secret`")) if secret else None
    if found is not None and is_token(found.text):
        raise PermissionDenied(
            "a process with a client token cannot host channels, because the token proves only a client; give the "
            "process the cluster's secret, or a certificate of the role host"
        )
    return Dialer(secret=found, tls=load_tls(given.tls.files, Role.HOST) if given.tls else None)
