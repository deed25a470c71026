"""Runs a service that ends with the process that started it: `python -m stampede_rt_local.parent_watch MODULE ...`.

Standard input is a pipe whose other end only the parent holds. The kernel closes it however the parent ends, SIGKILL
included, and then the service ends. (Linux's PR_SET_PDEATHSIG fires when the *thread* that forked ends, and
other systems have nothing like it.)
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading

GRACE_SECONDS = 5.0  # more than a service needs to stop in order


def _end_with_parent() -> None:
    while os.read(0, 4096):  # until end of file; nobody writes
        pass
    killer = threading.Timer(GRACE_SECONDS, os.kill, (os.getpid(), signal.SIGKILL))
    killer.daemon = True
    killer.start()
    os.kill(os.getpid(), signal.SIGTERM)


def main() -> None:
    """Become the module named first, with the other words as its arguments."""
    _, module, *arguments = sys.argv
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
