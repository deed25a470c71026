"""A server of Azure blobs (azurite, from npm) as a process, for tests. It is Microsoft's emulator of Azure Storage.

`python -m tests.support.channel_host.azure_server` installs it beforehand, which takes about a minute. The program is
in the user's cache folder, where all checkouts find it.
"""

from __future__ import annotations

import fcntl
import hmac
import os
import socket
import subprocess
import sys
import time
from base64 import b64decode, b64encode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from email.utils import formatdate
from http.client import HTTPConnection
from pathlib import Path

import pytest

from tests.polyglot.toolchains import BuildFailed, Unavailable, step, tool

VERSION = "3.35.0"
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stampede-rt" / f"azurite-{VERSION}"
CONTAINER = "archives"
ACCOUNT = "devstoreaccount1"  # the account of each azurite, with its published key
KEY = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="
START_SECONDS_MAX = 30


def build() -> Path:
    """Install the program, unless this machine has it, and return its path. Raises Unavailable, BuildFailed."""
    tool("node")
    program, done = CACHE / "node_modules" / ".bin" / "azurite-blob", CACHE / "installed"
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            words = ["install", "--no-audit", "--no-fund", "--prefix", str(CACHE), f"azurite@{VERSION}"]
            step([tool("npm"), *words], CACHE, {**os.environ})
            done.touch()  # after the installation, so an interrupted one does not count
    return program


class AzureServer:
    """One server with one container, which keeps its blobs in memory."""

    def __init__(self, program: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        words = ["--inMemoryPersistence", "--silent", "--skipApiVersionCheck", "--disableTelemetry"]
        self._process = subprocess.Popen(
            [program, "--blobHost", "127.0.0.1", "--blobPort", str(self._port), *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    @property
    def environment(self) -> dict[str, str]:
        """The variables of a client."""
        return {
            "AZURE_STORAGE_ACCOUNT_NAME": ACCOUNT,
            "AZURE_STORAGE_ACCOUNT_KEY": KEY,
            "AZURE_STORAGE_ENDPOINT": f"http://127.0.0.1:{self._port}/{ACCOUNT}",
            "AZURE_ALLOW_HTTP": "true",
        }

    def begin(self) -> None:
        """Wait until the process takes connections, and make the container."""
        deadline = time.monotonic() + START_SECONDS_MAX
        while True:  # paced by the short wait for the process
            try:
                socket.create_connection(("127.0.0.1", self._port), timeout=1).close()
                break
            except OSError:
                if time.monotonic() > deadline:
                    raise
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(0.02)
                raise RuntimeError("the server of Azure blobs has ended")
        self._make_container()

    def _make_container(self) -> None:
        path = f"/{ACCOUNT}/{CONTAINER}"
        headers = {"x-ms-date": formatdate(usegmt=True), "x-ms-version": "2021-08-06"}
        header_lines = "".join(f"{name}:{value}\n" for name, value in sorted(headers.items()))
        text = "PUT" + "\n" * 12 + f"{header_lines}/{ACCOUNT}{path}\nrestype:container"
        signature = b64encode(hmac.digest(b64decode(KEY), text.encode(), "sha256")).decode()
        connection = HTTPConnection("127.0.0.1", self._port, timeout=START_SECONDS_MAX)
        signed = {**headers, "Content-Length": "0", "Authorization": f"SharedKey {ACCOUNT}:{signature}"}
        connection.request("PUT", f"{path}?restype=container", headers=signed)
        answer = connection.getresponse()
        assert answer.status == 201, answer.read()
        connection.close()

    def stop(self) -> None:
        """Kill the process. Its blobs are gone."""
        self._process.kill()
        self._process.wait()


@contextmanager
def azure_server() -> Iterator[AzureServer]:
    """A running server; skips the test, and says why, if it cannot be installed here."""
    try:
        program = build()
    except Unavailable as reason:
        pytest.skip(f"no server of Azure blobs: {reason}; the same tests run with an S3 server and a folder")
    server = AzureServer(program)
    try:
        server.begin()
        yield server
    finally:
        server.stop()


if __name__ == "__main__":
    try:
        build()
    except (Unavailable, BuildFailed) as failure:
        sys.exit(f"no server of Azure blobs: {failure}")
