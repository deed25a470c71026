"""Does work in a separate process, which ends with the work or is killed. Work that hangs delays nothing else."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, TypeVar

R = TypeVar("R")
_SPAWNED = multiprocessing.get_context("spawn")


class WorkNotFinished(Exception):
    """The work failed, or its process was killed; the text says why."""


def in_own_process(work: Callable[..., R], *arguments: Any, seconds: float) -> R:
    """Return the result of `work`, which must be a function of a module. Raises WorkNotFinished."""
    receiver, sender = _SPAWNED.Pipe(duplex=False)
    process = _SPAWNED.Process(target=_do, args=(sender, work, arguments))
    process.start()
    sender.close()
    try:
        if not receiver.poll(seconds):
            raise WorkNotFinished(f"it was killed after {seconds:.0f} s")
        failure, found = receiver.recv()
    except EOFError:
        process.join()
        raise WorkNotFinished(f"its process ended with status {process.exitcode}") from None
    finally:
        process.kill()  # the services that it started end with it
        process.join()
    if failure:
        raise WorkNotFinished(failure)
    return found  # type: ignore[no-any-return]


def _do(sender: Connection, work: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    try:
        sender.send(("", work(*arguments)))
    except Exception as error:  # noqa: BLE001 - every error is reported
        sender.send((repr(error), None))
