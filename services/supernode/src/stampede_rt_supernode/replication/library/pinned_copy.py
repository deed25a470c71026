"""Loads the Raft module of PySyncObj, in a pinned version, as a private copy that uses our clock, log and snapshots.

The library binds its clock, its random source, its pickle, its log and its poller as module globals. This module runs
the library's code once more in a new namespace, and binds our objects there. The module that others may import stays
unchanged. Because we override private methods by name, the version of the file is pinned.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from importlib.machinery import SourceFileLoader
from importlib.metadata import version
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NoReturn

from stampede_rt_supernode.replication.library.node import RandomSource

PINNED_VERSION = "0.3.17"
PINNED_SHA256 = "e8bdf06797085d734df86e24ab4802fe87893dff77268565ec036f7ad4a1cfe4"


class LibraryMismatch(RuntimeError):
    """PySyncObj is not installed, or is not the pinned version, whose faults our rules correct."""


class _NoPickle:
    """Replaces pickle in the library. With our configuration the library never uses pickle; any use is an error."""

    def loads(self, data: object) -> NoReturn:
        raise RuntimeError("the replicated log never unpickles")

    dumps = loads
    to_bytes = loads


class _NoPoller:
    """Replaces the library's socket poller. Our transport has no sockets on the tick thread."""

    def poll(self, timeout: float) -> None:
        """Return immediately."""


def check_pin(*, found_version: str, source: bytes) -> None:
    """Raise LibraryMismatch unless this is exactly the pinned release."""
    digest = hashlib.sha256(source).hexdigest()
    if found_version != PINNED_VERSION or digest != PINNED_SHA256:
        raise LibraryMismatch(
            f"PySyncObj {found_version} (syncobj.py sha256 {digest[:12]}...) is installed, but the replicated log "
            f"overrides private methods of {PINNED_VERSION} ({PINNED_SHA256[:12]}...) only: install that version"
        )


@lru_cache(maxsize=1)
def _pinned_code() -> CodeType:
    try:
        import pysyncobj
    except ImportError as error:
        raise LibraryMismatch(f"PySyncObj is not installed: install pysyncobj=={PINNED_VERSION}") from error
    loader = SourceFileLoader("pysyncobj.syncobj", str(Path(pysyncobj.__file__).with_name("syncobj.py")))
    check_pin(found_version=version("pysyncobj"), source=loader.get_data(loader.path))
    # From Python's cache, if the cache is of this file, because a compilation takes 15 ms.
    code = loader.get_code(loader.name)
    assert code is not None, "a loader of a source file always has code"
    return code


def load_library(*, clock: Callable[[], float], random_source: RandomSource) -> Any:
    """A private copy of the library's Raft module.

    The copy reads `clock` (seconds, monotonic) and draws random numbers from `random_source`. It takes the log from
    `journalFile` of its configuration, and the snapshots from `serializer`. Raises LibraryMismatch.
    """
    module: Any = ModuleType("pysyncobj.stampede_private_copy")
    module.__package__ = "pysyncobj"
    exec(_pinned_code(), module.__dict__)
    module.pickle = _NoPickle()
    module.monotonicTime = clock
    module.random = random_source
    module.createPoller = lambda kind: _NoPoller()
    module.PIPE_NOTIFIER_ENABLED = False
    module.createJournal = lambda log: log
    module.Serializer = lambda path, batch_bytes, use_fork, serializer, deserializer, checker: serializer
    return module
