"""Logs a defect that has ended a task of the archive."""

from __future__ import annotations

import asyncio
import logging

logger = logging.getLogger(__name__)


def log_defect(task: asyncio.Task[None]) -> None:
    """Log the defect that has ended a task, if one has. Items then stay in memory or on the disk."""
    if not task.cancelled() and (failure := task.exception()) is not None:
        logger.error(
            "a task of the host ended with a defect",
            exc_info=failure,
            extra={"event": "task_defect", "task": task.get_name()},
        )
