"""The check that confines the private names of PySyncObj."""

from __future__ import annotations

from tools.private_names import OWNER, intruders, main


def test_a_module_with_a_private_name_is_found() -> None:
    assert intruders([("a.py", "self._SyncObj__raftLog"), ("b.py", "self.log")]) == ["a.py"]


def test_the_adapter_may_use_private_names() -> None:
    assert intruders([(OWNER, "self._SyncObj__raftLog")]) == []


def test_no_other_module_of_this_repository_uses_a_private_name() -> None:
    assert main() == 0
