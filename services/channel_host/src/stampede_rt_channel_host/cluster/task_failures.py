"""The failure of a group of tasks."""

from __future__ import annotations

import asyncio
from typing import Any


def first_failure(group: BaseExceptionGroup[Any]) -> BaseException:
    """The first failure in what a TaskGroup has raised.

    Raises CancelledError if the present task was cancelled: a TaskGroup of Python 3.11 and 3.12 raises only the
    failures if one of its tasks fails in the turn of the cancellation. Then the task would continue.
    """
    present = asyncio.current_task()
    if present is not None and present.cancelling():
        raise asyncio.CancelledError
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
