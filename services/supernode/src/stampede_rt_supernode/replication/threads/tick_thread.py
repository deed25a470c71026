"""The one thread on which the log runs. It takes a step when something arrives, and after the pause of the replica.

A second thread watches whether each step ends. A disk that hangs gives no error, and would hold the log's thread for
ever.
"""

from __future__ import annotations

import logging
import os
import sqlite3
import sys
import threading
import time
from collections.abc import Callable
from typing import NoReturn, Protocol

from stampede_rt.escaping import escaped
from stampede_rt_supernode.replication.interface import ReleaseTooOld

logger = logging.getLogger(__name__)

# As in sysexits(3), EX_SOFTWARE: the log has failed.
EXIT_CODE = 70
# As in sysexits(3), EX_IOERR: the data folder cannot be written.
EXIT_DISK = 74
# The exit code if the cluster is at a feature level that this release does not know. The user can mend that.
EXIT_TOO_OLD = 1
# If a step takes longer, the disk counts as hanging. After this time the other members have elected a new leader.
STUCK_SECONDS = 3.0
# The second thread looks at the present step once in this time.
LOOK_SECONDS = 0.5


def end_process(error: BaseException) -> NoReturn:
    """Log the reason and end the process immediately: a replica that failed half-way must not answer any caller."""
    code = EXIT_CODE
    if isinstance(error, ReleaseTooOld):
        why, code = str(error), EXIT_TOO_OLD
    elif isinstance(error, sqlite3.OperationalError):  # an error of the disk, not of the program
        code = EXIT_DISK
        why = (
            f"its data folder cannot be written ({error}), so it ends now; make room there, or mend the disk, and "
            "start it again with that folder: nothing that was acknowledged is lost"
        )
    else:
        logger.error("the replicated log failed", exc_info=error, extra={"event": "replicated_log_failed"})
        why = f"the replicated log failed and the process ends: {error!r}"
    print(f"stampede supernode: {escaped(why)}", file=sys.stderr)  # noqa: T201
    sys.stderr.flush()
    os._exit(code)


class TickedReplica(Protocol):
    """The object that the thread drives: a replica of the log."""

    def step(self) -> bool:
        """Do everything that is due. Returns True if another step is due immediately. An exception ends the thread."""

    def pause_seconds(self) -> float:
        """Return the longest time until the next step, if nothing wakes the thread."""

    def close(self) -> None:
        """Free all resources."""


class TickThread:
    """Drives a replica. Any thread may call `wake`. Only the owner's thread may call `start` and `stop`."""

    def __init__(self, *, on_fatal: Callable[[BaseException], None]) -> None:
        self._on_fatal = on_fatal
        self._work = threading.Event()
        self._stopping = False
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()
        # the start of the present step; None between two steps
        self._step_began: float | None = None

    def stuck_seconds(self) -> float:
        """The seconds that the present step has lasted; 0 if that is STUCK_SECONDS or less. Callable on any thread."""
        began = self._step_began
        lasted = 0.0 if began is None else time.monotonic() - began
        return lasted if lasted > STUCK_SECONDS else 0.0

    def wake(self) -> None:
        """Have the thread take the next step now. Never blocks."""
        self._work.set()

    def start(self, replica: TickedReplica) -> None:
        """Begin to tick. From now on the replica belongs to this thread."""
        self._thread = threading.Thread(target=self._run, args=(replica,), name="replicated-log", daemon=True)
        self._thread.start()
        threading.Thread(target=self._watch, name="replicated-log-watch", daemon=True).start()

    def stop(self) -> None:
        """Stop ticking and close the replica. Blocks until both are done."""
        self._stopping = True
        self.wake()
        if self._thread is not None:
            self._thread.join()

    def _run(self, replica: TickedReplica) -> None:
        try:
            while not self._stopping:
                # cleared before the step, so that an arrival during the step causes the next one immediately
                self._work.clear()
                self._step_began = time.monotonic()
                has_more_work = replica.step()
                self._step_began = None
                if not has_more_work:
                    self._work.wait(replica.pause_seconds())
            replica.close()
        except BaseException as error:  # noqa: BLE001 - whatever it is, to continue would be worse
            self._on_fatal(error)
        finally:
            self._ended.set()

    def _watch(self) -> None:
        """Log once that the disk hangs, and once that it answers again.

        The thread counts how often it finds the same step, and measures no time. While the whole process is stopped,
        time passes, but the disk is not slow.
        """
        stuck_since: float | None = None
        last_began, repeats = None, 0
        while not self._ended.wait(LOOK_SECONDS):
            began, now = self._step_began, time.monotonic()
            repeats = repeats + 1 if began == last_began else 0
            last_began = began
            if stuck_since is None and began is not None and repeats * LOOK_SECONDS >= STUCK_SECONDS:
                stuck_since = began
                logger.error(
                    "the disk of the data folder has not answered for %.0f s: this supernode accepts no "
                    "changes and no reads until it does; the other supernodes continue without it. Mend the disk; if "
                    "it does not come back, remove this member and join a new one",
                    STUCK_SECONDS,
                    extra={"event": "disk_silent"},
                )
            elif stuck_since is not None and began != stuck_since:
                logger.warning(
                    "the disk of the data folder answers again, after %.1f s",
                    now - stuck_since,
                    extra={"event": "disk_answers"},
                )
                stuck_since = None
