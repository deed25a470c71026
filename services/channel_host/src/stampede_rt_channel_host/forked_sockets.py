"""Closes the copies of a server's sockets in a forked child. Finds them by their local ends.

gRPC does not show which descriptors are its own.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat

_ANY = ("0.0.0.0", "::")
_IPV4_AS_IPV6 = "::ffff:"


def close_copies(address: str, path: str) -> None:
    """Close the sockets of this process at a TCP address "HOST:PORT" and at a Unix path. Empty: there is none.

    The descriptors stay in use: the objects that own them may close them later, and must not close other files then.
    """
    with open(os.devnull, "rb") as nothing:
        for descriptor in _sockets_of_this_process():
            with contextlib.suppress(OSError):  # the other sockets have to be closed, too
                if _is_end_of(descriptor, address, path):
                    os.dup2(nothing.fileno(), descriptor, inheritable=False)


def _sockets_of_this_process() -> list[int]:
    """The file descriptors of this process that are sockets."""
    try:
        descriptors = [int(name) for name in os.listdir("/dev/fd")]
    except OSError:  # the system has no such folder: a child keeps the sockets open
        return []
    return [one for one in descriptors if _is_socket(one)]


def _is_socket(descriptor: int) -> bool:
    try:
        return stat.S_ISSOCK(os.fstat(descriptor).st_mode)
    except OSError:  # the descriptor with which the folder was listed
        return False


def _is_end_of(descriptor: int, address: str, path: str) -> bool:
    """Whether a socket listens at the address or path, or was accepted there."""
    one = socket.socket(fileno=descriptor)
    try:
        family, kind, name = one.family, one.type, one.getsockname()
    finally:
        one.detach()  # another object closes it
    if kind != socket.SOCK_STREAM:
        return False
    if family == socket.AF_UNIX:
        return path != "" and name == path
    if family not in (socket.AF_INET, socket.AF_INET6) or not address:
        return False
    host, _, port = address.rpartition(":")
    return bool(name[1] == int(port)) and _may_be(name[0].removeprefix(_IPV4_AS_IPV6), host.strip("[]"))


def _may_be(ip: str, host: str) -> bool:
    """Whether a server at `host` may have sockets at an IP address. A name may stand for any address, "localhost" only
    for the machine's own.
    """
    if host == "localhost":
        return ip in ("127.0.0.1", "::1")
    is_name = not (host.replace(".", "").isdigit() or ":" in host)
    return is_name or host in _ANY or ip in (host, *_ANY)
