"""Removes the frames of errors that outlive their functions, so that reference counts free the objects in these frames.

An error's traceback refers to the frames of all functions that the error passed, and each frame to its variables. A
task keeps its error. The object that started the task often keeps the task, and a frame of the task refers to this
object. Such a cycle keeps everything that the functions used, such as a message of a megabyte, until a run of Python's
garbage collector, which looks at older objects seldom.
"""

from __future__ import annotations

import asyncio
from typing import Any


def failure_of(task: asyncio.Task[Any]) -> BaseException | None:
    """Return the error of an ended task; None if the task was cancelled or has succeeded.

    A task keeps the frames of its error or of its cancellation until code asks for its result, as this function does.
    `Task.exception` does not remove them.
    """
    try:
        task.result()
    except asyncio.CancelledError as cancellation:
        drop_frames(cancellation)
    except BaseException as failure:  # noqa: BLE001  # the caller gets it
        return failure
    return None


def drop_frames(error: BaseException) -> None:
    """Remove the frames of an error, and the frames of the errors that led to it."""
    error.__traceback__ = None
    former = _led_to(error)
    for one in former:  # the list grows meanwhile
        if one is not None and one.__traceback__ is not None:
            one.__traceback__ = None
            former += _led_to(one)


def _led_to(error: BaseException) -> list[BaseException | None]:
    return [error.__cause__, error.__context__, *getattr(error, "exceptions", ())]
