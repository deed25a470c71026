"""The settings and credentials of a host inside a program, from the arguments of `stampede_rt.host`."""

from __future__ import annotations

import re
from pathlib import Path

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
from stampede_rt_runtime.settings import SettingsError
from stampede_rt_runtime.tls import load_tls
from stampede_rt_runtime.values import parse_address_text, parse_target

MISUSES = (CannotListen, AddressNotAllowed, SettingsError, ValueError)
"""The errors of a host that cannot start with its arguments."""


def settings_of(target: Target, options: HostOptions) -> HostSettings:
    """The settings of the host. Raises InvalidArgument."""
    try:
        return HostSettings(
            listen=parse_address_text(options.listen) if options.listen else "",
            advertise=parse_target(options.advertise) if options.advertise else "",
            name=target.name,
            frontend=target.frontends,
            zone=target.zone,
            memory_bytes_max=options.memory_bytes_max,
            allow_insecure_anywhere=options.allow_insecure_anywhere,
            private=options.private,
            archive=_archive_of(options.archive) if options.archive else None,
            archive_folder=_folder_of(options.archive_folder) if options.archive_folder else None,
            archive_bytes_max=options.archive_bytes_max,
        )
    except ValueError as error:
        raise cannot_host(error) from error


def _archive_of(text: str) -> Path | str:
    """The place of an archive: a folder, or a URL. Raises ValueError."""
    place = parse_archive(text)
    return place if isinstance(place, str) else _folder_of(text)


def _folder_of(text: str) -> Path:
    """A folder, which stays the same if the program changes its working folder later."""
    return Path(text).expanduser().absolute()


def cannot_host(error: Exception) -> InvalidArgument:
    """The error for the caller of `stampede_rt.host`, whose arguments have the names of the flags."""
    text = str(error).replace("--archive-bytes-max", "max_archive")
    text = re.sub(r"--([a-z][a-z-]*)", lambda found: found[1].replace("-", "_"), text)
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
            "a process with a client token cannot host channels, because hosts check callers; give it the "
            "cluster's secret, or a certificate of the role host"
        )
    return Dialer(secret=found, tls=load_tls(given.tls.files, Role.HOST) if given.tls else None)
