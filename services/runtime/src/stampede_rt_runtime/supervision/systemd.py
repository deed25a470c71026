"""Tells systemd the state of this service, if systemd started it with `Type=notify`.

The protocol (sd_notify(3)) is one datagram for each change, so no library is needed.
"""

from __future__ import annotations

import logging
import os
import socket

READY, STOPPING = "READY=1", "STOPPING=1"
SOCKET_VARIABLE = "NOTIFY_SOCKET"

logger = logging.getLogger(__name__)


def notify_systemd(state: str) -> None:
    """Send `state` to the service's supervisor. Does nothing if no supervisor asks for it.

    Does not block: if the supervisor does not read, the state is lost, and the log says so.
    """
    address = os.environ.get(SOCKET_VARIABLE, "")
    if not address:
        return
    if address.startswith("@"):  # an abstract socket
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as one:
            one.setblocking(False)
            one.sendto(state.encode(), address)
    except OSError as error:
        logger.warning(
            "systemd does not learn the state of this service",
            extra={"event": "supervisor_not_told", "state": state, "why": str(error)},
        )


def without_supervisor() -> dict[str, str]:
    """The environment for a process that must not report its state to systemd."""
    return {name: value for name, value in os.environ.items() if name != SOCKET_VARIABLE}
