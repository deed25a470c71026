"""Starts two fake services, one of them stubborn, prints their process ids, and waits to be killed."""

from __future__ import annotations

import signal

from stampede_rt_local.process import ServiceProcess


def main() -> None:
    services = [ServiceProcess(one, "tests.support.fake_service", [one]) for one in ("good", "stubborn")]
    for one in services:
        one.start()
    for one in services:
        one.wait_ready(20)
    print(*(one.pid for one in services), flush=True)
    signal.pause()


if __name__ == "__main__":
    main()
