"""A process that has loaded the modules of all services. It forks for each service that a test starts.

`python -P loaded_process.py FD`: FD is a socket to the process of the tests. A request is a JSON object with the
service's arguments, environment and folder, and its three standard streams. The answer is its process id.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import socket
import sys
from typing import Any

import stampede_rt.grpc_quiet  # noqa: F401  # before the services import gRPC
from stampede_rt_runtime import parent_watch

SERVICES = ("stampede_rt_supernode", "stampede_rt_channel_host", "stampede_rt_frontend")
REQUEST_BYTES_MAX = 2**17


def serve(calls: socket.socket) -> None:
    """Fork for each request, until the tests end. Returns only in the fork, which then becomes the service."""
    while True:
        request, streams, _, _ = socket.recv_fds(calls, REQUEST_BYTES_MAX, 3)
        if not request:
            sys.exit()
        readable, sender = os.pipe()
        between = os.fork()
        if between == 0:
            # The process of the tests becomes the parent of this process's child, and can then wait for the child's
            # end.
            if child := os.fork():
                os.write(sender, str(child).encode())
                os._exit(0)
            return become(json.loads(request), streams, unused=(readable, sender, calls.detach()))
        for file in (*streams, sender):
            os.close(file)
        os.waitpid(between, 0)
        calls.send(os.read(readable, 32))
        os.close(readable)


def become(request: dict[str, Any], streams: list[int], *, unused: tuple[int, ...]) -> None:
    """Take the arguments, environment, folder and standard streams of the service."""
    os.setpgid(0, 0)
    for number, file in enumerate(streams):
        os.dup2(file, number)
    for file in (*streams, *unused):
        os.close(file)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = [sys.argv[0], *request["arguments"]]


if __name__ == "__main__":
    gc.disable()
    for service in SERVICES:
        importlib.import_module(f"{service}.app")
    gc.freeze()
    serve(socket.socket(fileno=int(sys.argv[1])))
    parent_watch.main()
