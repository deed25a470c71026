"""The entry point of the command `stampede`: Ctrl-C prints no traceback while the other modules load.

Python's own handler would raise KeyboardInterrupt inside an import. This module imports only `_signal`: `signal` takes
longer to load than the rest.
"""

from _signal import SIG_DFL, SIGINT, default_int_handler, getsignal, signal  # type: ignore[import-not-found]


def main() -> int:
    """Run the command line and return its exit status. While modules load, Ctrl-C ends the process immediately."""
    is_usual = getsignal(SIGINT) is default_int_handler  # a caller may have made the process ignore Ctrl-C
    if is_usual:
        signal(SIGINT, SIG_DFL)
    from stampede_rt.cli.exit_statuses import INTERRUPTED
    from stampede_rt.cli.main import main as run

    try:
        if is_usual:
            signal(SIGINT, default_int_handler)
        return run()
    except KeyboardInterrupt:  # before `run` has its own handler
        return INTERRUPTED
