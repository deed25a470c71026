"""The one thread that the log runs on. It sleeps until something comes in, and ticks now and then anyway."""

from __future__ import annotations

import os
import sqlite3
import sys
import threading
import traceback
from collections.abc import Callable
from typing import NoReturn

from stampede_rt_supernode.replication.replica import Replica

EXIT_CODE = 70


def end_process(error: BaseException) -> NoReturn:
    """Say why and end the process at once: a replica that failed half-way must not answer anybody any more."""
    if isinstance(error, sqlite3.OperationalError):  # of the disk, not of the program
        why = (
            f"its data folder cannot be written ({error}), so it ends at once; make room there, or mend the disk, and "
            "start it again with that folder: nothing that was acknowledged is lost"
        )
    else:
        traceback.print_exception(error, file=sys.stderr)
        why = f"the replicated log failed and the process ends: {error!r}"
    print(f"stampede supernode: {why}", file=sys.stderr)  # noqa: T201
    sys.stderr.flush()
    os._exit(EXIT_CODE)


class TickThread:
    """Drives a replica. `wake` may be called from any thread; `start` and `stop` from the one that owns it."""

    def __init__(self, *, tick_seconds: float, on_fatal: Callable[[BaseException], None]) -> None:
        self._tick_seconds = tick_seconds
        self._on_fatal = on_fatal
        self._work = threading.Event()
        self._stopping = False
        self._thread: threading.Thread | None = None

    def wake(self) -> None:
        """Have the next step done now."""
        self._work.set()

    def start(self, replica: Replica) -> None:
        """Begin to tick; from now on the replica belongs to this thread."""
        self._thread = threading.Thread(target=self._run, args=(replica,), name="replicated-log", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop ticking and close the replica; blocks until both are done."""
        self._stopping = True
        self.wake()
        if self._thread is not None:
            self._thread.join()

    def _run(self, replica: Replica) -> None:
        try:
            while not self._stopping:
                # Cleared before the step: whatever comes in during it has the next one done at once.
                self._work.clear()
                if not replica.step():
                    self._work.wait(self._tick_seconds)
            replica.close()
        except BaseException as error:  # noqa: BLE001 - whatever it is, going on would be worse
            self._on_fatal(error)
