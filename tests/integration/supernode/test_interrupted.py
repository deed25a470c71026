"""Ctrl-C before a service is ready ends it immediately, without a traceback from an import."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.support.supernode.processes import clean_environment

PATIENCE_SECONDS = 30.0


@pytest.mark.parametrize(
    ("service", "module", "words"),
    [
        ("stampede_rt_supernode", "grpc._cython", []),
        ("stampede_rt_supernode", "stampede_rt_supernode.replication", []),
        ("stampede_rt_frontend", "stampede_rt_frontend.app", ["--supernodes", "localhost:1"]),
        ("stampede_rt_channel_host", "grpc._cython", []),
    ],
)
def test_a_service_that_is_interrupted_while_it_is_loaded_ends_quietly(
    service: str, module: str, words: list[str]
) -> None:
    started = subprocess.Popen(
        [sys.executable, "-X", "importtime", "-m", service, "--listen", "localhost:0", *words],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        env=clean_environment(),
        text=True,
    )
    try:
        assert started.stderr is not None
        # Python prints a line for each module after its import. The lines of the modules that it imports come before
        # its own.
        reached = next((line for line in started.stderr if line.rpartition("|")[2].strip() == module), None)
        assert reached, f"{service} ended before it imported {module}"
        started.send_signal(signal.SIGINT)
        _, rest = started.communicate(timeout=PATIENCE_SECONDS)
    finally:
        started.kill()
        started.wait()
    assert "Traceback" not in rest
    assert started.returncode in (-signal.SIGINT, 0)  # 0: on a busy machine the service may have been ready by then
