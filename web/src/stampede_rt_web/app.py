"""`stampede web` as a process: settings, the address, the login token and the HTTP server."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import socket
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import uvicorn

from stampede_rt.errors import StampedeError
from stampede_rt.escaping import escaped
from stampede_rt_runtime.listen import AddressNotAllowed, CannotListen, check_listen
from stampede_rt_runtime.logs import log_defects, set_up_logging
from stampede_rt_runtime.main import announce
from stampede_rt_runtime.settings import EXIT_BAD_SETTINGS, HelpRequested, SettingsError, load_settings
from stampede_rt_runtime.supervision.systemd import STOPPING, notify_systemd
from stampede_rt_runtime.values import Address
from stampede_rt_web.guard import TOKEN_CHARACTERS_MIN, Guard
from stampede_rt_web.settings import WebSettings
from stampede_rt_web.site import Site

CONNECTIONS_MAX = 128  # the open connections and running requests; the server answers further requests with 503
KEEP_ALIVE_SECONDS = 20
SHUTDOWN_SECONDS = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede web` until Ctrl-C. Returns the exit code: 0 stopped, 1 cannot listen, 2 bad settings."""
    words = sys.argv[1:] if argv is None else argv
    try:
        settings = load_settings(WebSettings, service="web", argv=words, environ=os.environ)
        set_up_logging(settings.log_level, settings.log_format)
        log_defects()
        address = check_listen(settings.listen, allow_insecure_anywhere=settings.may_listen_anywhere)
        token = None if settings.token_file is None else read_token(settings.token_file)
        if settings.secret_file is not None:  # the client and `examine` take it from the environment
            os.environ["STAMPEDE_SECRET_FILE"] = str(settings.secret_file)
        asyncio.run(_serve(settings, address, token))
    except HelpRequested as help_request:
        print(help_request, end="")
        return 0
    except AddressNotAllowed:
        return _complain(
            f"{settings.listen} can be reached from other machines; beyond loopback the page needs --tls-certificate, "
            "--tls-key and --token-file",
            EXIT_BAD_SETTINGS,
        )
    except SettingsError as error:
        return _complain(str(error), EXIT_BAD_SETTINGS)
    except (CannotListen, StampedeError, OSError) as error:
        return _complain(str(error), 1)
    return 0


def read_token(path: Path) -> str:
    """Return the login token in the file. If the file is absent, makes one that only this user may read.

    Raises CannotListen if the token is too short, and OSError.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        token = path.read_text().strip()
    else:
        token = secrets.token_urlsafe(24)
        with os.fdopen(descriptor, "w") as file:
            file.write(token + "\n")
    if len(token) < TOKEN_CHARACTERS_MIN:
        raise CannotListen(f"the token in {path} has less than {TOKEN_CHARACTERS_MIN} characters; write a longer one")
    return token


async def _serve(settings: WebSettings, address: Address, token: str | None) -> None:
    site = Site(settings.url or None, settings.channels)
    secure = settings.tls_certificate is not None
    guarded = Guard(site.app(), token=token, secure=secure, loopback_only=not settings.may_listen_anywhere)
    config = uvicorn.Config(
        guarded,
        log_config=None,
        log_level="warning",  # only for the HTTP server, which at "info" repeats the ready line
        access_log=False,
        server_header=False,
        limit_concurrency=CONNECTIONS_MAX,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=SHUTDOWN_SECONDS,
        h11_max_incomplete_event_size=16 * 1024,
        ssl_certfile=settings.tls_certificate,
        ssl_keyfile=settings.tls_key,
        lifespan="off",
        ws="none",
    )
    server = _Server(config)
    sockets = _sockets(address)
    port = sockets[0].getsockname()[1]
    loop = asyncio.get_running_loop()
    for one in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(one, server.stop)
    announce(f"stampede web ready on {'https' if secure else 'http'}://{Address(address.host, port)}/")
    if token is not None:
        announce(f"log in with the token in {settings.token_file}")
    try:
        await server.serve(sockets=sockets)
    finally:
        await site.aclose()


class _Server(uvicorn.Server):
    """The HTTP server. The caller handles signals, so that the process ends with status 0."""

    def stop(self) -> None:
        """Stop after the running requests, at most SHUTDOWN_SECONDS later."""
        self.should_exit = True
        notify_systemd(STOPPING)

    def capture_signals(self) -> AbstractContextManager[None]:  # type: ignore[override]  # uvicorn's is a generator
        """Leave signals to the caller."""
        return nullcontext()


def _sockets(address: Address) -> list[socket.socket]:
    """Listen at all addresses of a name. With port 0 all of them get the same free port."""
    sockets: list[socket.socket] = []
    port = address.port
    for family, _, _, _, where in socket.getaddrinfo(address.host, port, type=socket.SOCK_STREAM):
        try:
            one = socket.create_server((where[0], port), family=family, backlog=CONNECTIONS_MAX)
        except OSError:
            if sockets:  # on a machine without IPv6, a name may still have an IPv6 address
                continue
            raise
        port = one.getsockname()[1]
        sockets.append(one)
    return sockets


def _complain(text: str, code: int) -> int:
    print(f"stampede web: {escaped(text)}", file=sys.stderr)
    return code
