"""The library is exactly the examined one, and its copy shares nothing with other copies."""

from __future__ import annotations

import random
from importlib.machinery import SourceFileLoader
from importlib.util import find_spec
from pathlib import Path

import pytest

from stampede_rt_supernode.replication.library import pinned_copy
from stampede_rt_supernode.replication.library.pinned_copy import (
    PINNED_VERSION,
    LibraryMismatch,
    check_pin,
    load_library,
)


def installed_source() -> bytes:
    spec = find_spec("pysyncobj.syncobj")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).read_bytes()


def test_the_installed_library_has_the_pinned_version() -> None:
    check_pin(found_version=PINNED_VERSION, source=installed_source())


def test_another_version_of_the_library_is_refused() -> None:
    with pytest.raises(LibraryMismatch, match=r"install that version"):
        check_pin(found_version="0.3.18", source=installed_source())


def test_a_changed_file_of_the_library_is_refused() -> None:
    with pytest.raises(LibraryMismatch, match=r"PySyncObj 0\.3\.17"):
        check_pin(found_version=PINNED_VERSION, source=installed_source() + b"\n")


def test_python_s_cache_serves_the_pinned_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, each supernode compiled the library at its start."""
    import pysyncobj.syncobj  # noqa: F401  # writes the cache

    pinned_copy._pinned_code.cache_clear()
    monkeypatch.setattr("builtins.compile", None)
    monkeypatch.setattr(SourceFileLoader, "source_to_code", None)
    assert "SyncObj" in pinned_copy._pinned_code().co_names


def test_the_adapted_library_uses_the_given_clock_and_cannot_unpickle() -> None:
    library = load_library(clock=lambda: 42.0, random_source=random.Random(0))
    assert library.monotonicTime() == 42.0
    with pytest.raises(RuntimeError, match="never unpickles"):
        library.pickle.loads(b"")
    with pytest.raises(RuntimeError, match="never unpickles"):
        library.pickle.dumps(())


def test_the_ordinary_module_of_the_library_is_unchanged() -> None:
    import pysyncobj.syncobj as ordinary

    load_library(clock=lambda: 42.0, random_source=random.Random(0))
    assert ordinary.monotonicTime() != 42.0
    assert ordinary.Serializer.__module__ == "pysyncobj.serializer"
