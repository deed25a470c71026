"""A service that counts its things on a signal: `python -m tests.robustness.cycles.counted_service PACKAGE FLAGS`.

The service keeps some things on purpose, up to a bound: the entries of a log, the changes that watches may still read,
the answers to repeated requests, and the producers whose puts a host still knows. Here these bounds are low, so the
first cycles reach them.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable

from tests.robustness.cycles.counting import count_on_signal
from tests.support.service_process import compact_early

SNAPSHOT_EVERY_ENTRIES, CHANGES_MAX, PRODUCERS_MAX = 50, 64, 16
MARK_NANOS = 10**9  # a supernode forgets its answers after six marks


def main() -> int:
    """Run the service; returns its exit code."""
    package, *words = sys.argv[1:]
    count_on_signal()
    if package == "stampede_rt_supernode":
        _bound_supernode()
    if package == "stampede_rt_channel_host":
        _bound_host()
    return int(importlib.import_module(f"{package}.app").main(words))


def _bound_supernode() -> None:
    from stampede_rt_supernode.core.change_ring import ChangeRing
    from stampede_rt_supernode.servicers import lease_keeper

    assert hasattr(lease_keeper, "MARK_NANOS"), "the constant has another name now"
    setattr(lease_keeper, "MARK_NANOS", MARK_NANOS)  # noqa: B010 - mypy: the module does not export it
    compact_early(SNAPSHOT_EVERY_ENTRIES)
    _set_default(ChangeRing.__init__, "changes_max", CHANGES_MAX)


def _bound_host() -> None:
    from stampede_rt_channel_host.core.dedup import RetryWindow

    _set_default(RetryWindow.__init__, "producers_max", PRODUCERS_MAX)


def _set_default(initializer: Callable[..., None], name: str, value: int) -> None:
    defaults: dict[str, int] = initializer.__kwdefaults__ or {}
    assert name in defaults, f"{initializer.__qualname__} has no {name} now"
    defaults[name] = value


if __name__ == "__main__":
    sys.exit(main())
