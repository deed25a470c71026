"""Runs a service that ends with the process that started it: `python -m stampede_rt_runtime.parent_watch MODULE ...`.

Standard input is a pipe, and only the parent has its other end. When the parent ends in any way, also by SIGKILL, the
kernel closes the pipe, and the service ends. (Linux's PR_SET_PDEATHSIG acts when the *thread* that forked ends, and
other systems do not have it.)
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading

GRACE_SECONDS = 5.0  # longer than a service needs to stop


def _end_with_parent() -> None:
    while os.read(0, 4096):  # until end of file; the parent writes nothing
        pass
    killer = threading.Timer(GRACE_SECONDS, os.kill, (os.getpid(), signal.SIGKILL))
    killer.daemon = True
    killer.start()
    os.kill(os.getpid(), signal.SIGTERM)


def main() -> None:
    """Run the module in the first argument, with the other arguments."""
    _, module, *arguments = sys.argv
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
