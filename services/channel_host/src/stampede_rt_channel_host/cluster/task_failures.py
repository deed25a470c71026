"""The failure of a group of tasks."""

from __future__ import annotations

import asyncio
from typing import Any


def first_failure(group: BaseExceptionGroup[Any]) -> BaseException:
    """The first failure of the tasks of a TaskGroup. Raises CancelledError if the present task was cancelled.

    If a task of the group fails in the turn in which the present task is cancelled, Python 3.11 and 3.12 raise the
    failure, and not CancelledError. Without this check the cancelled task would continue.
    """
    present = asyncio.current_task()
    if present is not None and present.cancelling():
        raise asyncio.CancelledError
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
