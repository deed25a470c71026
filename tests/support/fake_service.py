"""A process that behaves like a service, well or badly: `python -m tests.support.fake_service BEHAVIOUR`."""

from __future__ import annotations

import os
import signal
import sys


def print_line(line: str) -> None:
    print(line, flush=True)


def main() -> None:
    behaviour, *rest = sys.argv[1:]
    if behaviour == "fails":
        print("stampede fake: it cannot be", file=sys.stderr)
        sys.exit(3)
    if behaviour == "never-ready":
        print_line("still thinking")
    if behaviour == "stubborn":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if behaviour == "chatty":
        for number in range(10_000):
            print_line(f"line {number} " + "x" * 100)
    if behaviour == "environment":
        print_line(f"environment {sorted(name for name in os.environ if name.startswith('STAMPEDE_'))} {rest}")
    if behaviour != "never-ready":
        print_line(f"stampede fake f{os.getpid()} ready on localhost:{os.getpid()}")
    while True:
        signal.pause()


if __name__ == "__main__":
    main()
