"""Starts and ends every service process: reads the settings, runs the service, and returns the exit code.

For a user's mistake it prints one line, and no traceback.
"""

from __future__ import annotations

import asyncio
import logging
import os
import sys
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from stampede_rt.errors import StampedeError
from stampede_rt.escaping import escaped
from stampede_rt.security.tls import CLIENT_VARIABLES, TlsFiles
from stampede_rt_runtime import allocator, open_files
from stampede_rt_runtime.auth import Secret, load_client_secret, load_secret
from stampede_rt_runtime.dial import Dialer
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.listen import CannotListen, NotAllowed
from stampede_rt_runtime.logs import FORMATS, LEVELS, set_up_logging
from stampede_rt_runtime.settings import EXIT_BAD_SETTINGS, HelpRequested, SettingsError, load_settings, setting
from stampede_rt_runtime.supervision.systemd import READY, tell_systemd
from stampede_rt_runtime.tls import ServiceTls, load_tls
from stampede_rt_runtime.values import Address, parse_address, parse_address_text

logger = logging.getLogger(__name__)

EXIT_FAILED = 1


@dataclass(frozen=True, kw_only=True)
class ServiceSettings:
    """The settings that all services share. Each service also has its own `listen`."""

    secret_file: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            help="the file of the shared secret; without it: stampede/secret in the user's config folder, if it exists",
        ),
    )
    client_secret_file: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            help="the file of the clients' secret; a caller with this secret may do what clients do, but not join",
        ),
    )
    allow_insecure_anywhere: bool = field(
        default=False,
        metadata=setting(
            help="listen beyond this machine without encryption, although the whole network can read the items"
        ),
    )
    tls_ca: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            shared=False,
            help="the cluster's authorities (PEM); with it every caller needs a certificate",
        ),
    )
    tls_certificate: Path | None = field(
        default=None, metadata=setting(metavar="FILE", shared=False, help="this service's own certificate (PEM)")
    )
    tls_key: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            shared=False,
            help="the private key (PEM) of the certificate; only this service's user may read it",
        ),
    )
    log_level: str = field(
        default="info", metadata=setting(metavar="LEVEL", choices=LEVELS, help="log messages of this level and above")
    )

    reflection: bool = field(
        default=False,
        metadata=setting(
            help="describe the services of this port to every caller with a credential, for tools such as grpcurl"
        ),
    )
    log_format: str = field(
        default="text",
        metadata=setting(
            metavar="FORMAT",
            choices=FORMATS,
            help="the form of the log: lines of key=value, or one JSON object in each line",
        ),
    )
    metrics: str = field(
        default="",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_address_text,
            help="serve metrics for Prometheus at http://HOST:PORT/metrics; everybody who can reach this address can "
            "read them, so name a loopback address, such as localhost:9464, or one on a private network",
        ),
    )

    def metrics_address(self) -> Address | None:
        """The address for metrics; None: the service serves none."""
        return parse_address(self.metrics) if self.metrics else None

    def load_secret(self) -> Secret | None:
        """The secret, or None if there is none. Reads a file. Raises PermissionDenied.

        With certificates the secret is read only if a setting names its file, because certificates alone suffice.
        """
        if self.tls_ca is not None and self.secret_file is None and "STAMPEDE_SECRET_FILE" not in os.environ:
            return None
        return load_secret(self.secret_file)

    def load_tls(self, role: Role) -> ServiceTls | None:
        """The certificates, or None if no setting names them. Reads files. Raises SettingsError or PermissionDenied."""
        named = {"--tls-ca": self.tls_ca, "--tls-certificate": self.tls_certificate, "--tls-key": self.tls_key}
        missing = [flag for flag, path in named.items() if path is None]
        if len(missing) == len(named):
            return None
        if self.tls_ca is None or self.tls_certificate is None or self.tls_key is None:
            raise SettingsError(f"{' and '.join(missing)} must be given, too: certificates need {', '.join(named)}")
        return load_tls(TlsFiles(ca=self.tls_ca, certificate=self.tls_certificate, key=self.tls_key), role)

    def load_credentials(self, role: Role) -> Dialer:
        """The secrets and certificates, as the service's server and its outgoing connections need them."""
        secret = self.load_secret()
        clients = load_client_secret(self.client_secret_file, secret)
        return Dialer(secret=secret, client_secret=clients, tls=self.load_tls(role))


S = TypeVar("S", bound=ServiceSettings)


def run_service(
    cls: type[S], service: str, argv: Sequence[str] | None, serve: Callable[[S], Awaitable[int | None]]
) -> int:
    """Load the settings, run `serve` to its end on a new event loop, and return the process's exit code.

    `argv` is without the program's name; None: the arguments of this process. `serve` returns an exit code; None means
    0. Exit code 2: the settings are unusable; 1: the service failed to start or to go on. In both cases one line on
    stderr says why.
    """
    try:
        words = sys.argv[1:] if argv is None else argv
        settings = load_settings(cls, service=service, argv=words, environ=os.environ)
    except HelpRequested as asked:
        sys.stdout.write(str(asked))
        return 0
    except SettingsError as error:
        return _complain(service, error, EXIT_BAD_SETTINGS)
    set_up_logging(settings.log_level, settings.log_format)
    open_files.raise_limit()
    allocator.give_back_memory()
    _tell_of_clients_certificates(settings, service)
    try:
        return run_loop(serve(settings)) or 0
    except (NotAllowed, SettingsError) as error:
        return _complain(service, error, EXIT_BAD_SETTINGS)
    except (CannotListen, StampedeError) as error:
        return _complain(service, error, EXIT_FAILED)
    except OSError as error:
        if error.filename is None:
            raise  # a defect; but errors with a file name are for the user to correct
        return _complain(service, f"{error.filename} cannot be used: {error.strerror}", EXIT_FAILED)
    except KeyboardInterrupt:  # before the service handled signals itself
        return 130


def _tell_of_clients_certificates(settings: ServiceSettings, service: str) -> None:
    """Warn if the service has no certificates, but the environment names certificates for clients.

    The user may have meant them for the service.
    """
    named = [f"${name}" for name in CLIENT_VARIABLES if os.environ.get(name)]
    if named and settings.tls_ca is None:
        logger.warning(
            "no certificates are used: %s are for clients; name this service's own with --tls-ca, --tls-certificate "
            "and --tls-key, or in $STAMPEDE_%s_TLS_CA, ..._CERTIFICATE and ..._KEY",
            ", ".join(named),
            service.replace("-", "_").upper(),
            extra={"event": "client_certificates_ignored"},
        )


def _complain(service: str, error: Exception | str, code: int) -> int:
    sys.stderr.write(f"stampede {service}: {escaped(str(error))}\n")
    return code


R = TypeVar("R")


def run_loop(work: Awaitable[R]) -> R:
    """Run `work` to its end on a new event loop, of uvloop if it is installed."""

    async def whole() -> R:
        return await work

    try:
        import uvloop
    except ImportError:
        factory = asyncio.new_event_loop
    else:
        factory = uvloop.new_event_loop
    with asyncio.Runner(loop_factory=factory) as runner:
        return runner.run(whole())


def announce(line: str) -> None:
    """Print the ready line on stdout and flush it, because the process's starter waits for it. Tell systemd, too."""
    sys.stdout.write(escaped(line) + "\n")
    sys.stdout.flush()
    tell_systemd(READY)
