"""Starts and ends every service process: reads the settings, runs the service, and returns the exit code.

For a user's mistake it prints one line, and no traceback.
"""

from __future__ import annotations

import asyncio
import logging
import os
import sys
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

from stampede_rt.errors import StampedeError
from stampede_rt.escaping import escaped
from stampede_rt.security.tls import CLIENT_VARIABLES
from stampede_rt_runtime import open_files
from stampede_rt_runtime.listen import AddressNotAllowed, CannotListen
from stampede_rt_runtime.logs import log_defects, set_up_logging
from stampede_rt_runtime.memory import allocator
from stampede_rt_runtime.service_settings import ServiceSettings
from stampede_rt_runtime.settings import EXIT_BAD_SETTINGS, HelpRequested, SettingsError, load_settings
from stampede_rt_runtime.supervision.systemd import READY, notify_systemd

logger = logging.getLogger(__name__)

EXIT_FAILED = 1


S = TypeVar("S", bound=ServiceSettings)


def run_service(
    cls: type[S], service: str, argv: Sequence[str] | None, serve: Callable[[S], Awaitable[int | None]]
) -> int:
    """Load the settings, run `serve` to its end on a new event loop, and return the process's exit code.

    `argv` is without the program's name; None: the arguments of this process. `serve` returns an exit code; None means
    0. Exit code 2: the settings are unusable; 1: the service failed to start or to continue. In both cases one line on
    stderr says why.
    """
    try:
        words = sys.argv[1:] if argv is None else argv
        settings = load_settings(cls, service=service, argv=words, environ=os.environ)
    except HelpRequested as help_request:
        sys.stdout.write(str(help_request))
        return 0
    except SettingsError as error:
        return _complain(service, error, EXIT_BAD_SETTINGS)
    set_up_logging(settings.log_level, settings.log_format)
    log_defects()
    open_files.raise_limit()
    allocator.give_back_memory()
    _warn_of_clients_certificates(settings, service)
    try:
        return run_loop(serve(settings)) or 0
    except (AddressNotAllowed, SettingsError) as error:
        return _complain(service, error, EXIT_BAD_SETTINGS)
    except (CannotListen, StampedeError) as error:
        return _complain(service, error, EXIT_FAILED)
    except OSError as error:
        if error.filename is None:
            raise  # a defect; but errors with a file name are for the user to correct
        return _complain(service, f"{error.filename} cannot be used: {error.strerror}", EXIT_FAILED)
    except KeyboardInterrupt:  # before the service handled signals itself
        return 130


def _warn_of_clients_certificates(settings: ServiceSettings, service: str) -> None:
    """Warn if the service has no certificates, but the environment names certificates for clients.

    The user may have meant them for the service.
    """
    named = [f"${name}" for name in CLIENT_VARIABLES if os.environ.get(name)]
    if named and settings.tls_ca is None:
        logger.warning(
            "this service uses no certificates: only clients use %s; name this service's own with --tls-ca, "
            "--tls-certificate and --tls-key, or in $STAMPEDE_%s_TLS_CA, ..._CERTIFICATE and ..._KEY",
            ", ".join(named),
            service.replace("-", "_").upper(),
            extra={"event": "client_certificates_ignored"},
        )


def _complain(service: str, error: Exception | str, code: int) -> int:
    sys.stderr.write(f"stampede {service}: {escaped(str(error))}\n")
    return code


R = TypeVar("R")


def run_loop(work: Awaitable[R]) -> R:
    """Run `work` to its end on a new event loop. If uvloop is installed, this is an event loop of uvloop."""

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
    notify_systemd(READY)
