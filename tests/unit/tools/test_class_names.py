"""The guard of class names: each name stands for one thing, except the listed names."""

from __future__ import annotations

import pytest

from tools import class_names
from tools.class_names import AcceptedNames, complaints, duplicates, read_lists

NOBODY = AcceptedNames({}, {})
NAMES_TO_RENAME_AT_FIRST = 41


def test_two_modules_with_one_class_name_are_reported_with_their_paths() -> None:
    found = duplicates([("a/one.py", "class Place: ..."), ("b/two.py", "class Place: ...\nclass Other: ...")])
    assert found == {"Place": ["a/one.py", "b/two.py"]}
    (line,) = complaints(found, NOBODY)
    assert "a/one.py, b/two.py" in line


def test_the_async_and_the_blocking_transport_are_one_thing() -> None:
    pair = [("t/grpc_async.py", "class Port: ..."), ("t/grpc_sync.py", "class Port: ...")]
    assert duplicates(pair) == {}
    assert duplicates([*pair, ("host/port.py", "class Port: ...")]) == {"Port": ["host/port.py", "t/grpc_async.py"]}


def test_classes_that_one_module_keeps_to_itself_may_have_any_name() -> None:
    assert duplicates([("a.py", "class _Step: ..."), ("b.py", "class _Step: ...")]) == {}
    assert duplicates([("a.py", "class Out:\n    class In: ..."), ("b.py", "class In: ...")]) == {}


@pytest.mark.parametrize("accepted", [AcceptedNames({"Place": 2}, {}), AcceptedNames({}, {"Place": 2})])
def test_a_listed_name_passes_until_a_third_class_takes_it(accepted: AcceptedNames) -> None:
    assert complaints({"Place": ["a.py", "b.py"]}, accepted) == []
    assert len(complaints({"Place": ["a.py", "b.py", "c.py"]}, accepted)) == 1


def test_an_entry_must_go_when_its_name_has_one_meaning() -> None:
    for listed in (AcceptedNames({"Place": 2}, {}), AcceptedNames({}, {"Place": 2})):
        (line,) = complaints({}, listed)
        assert "delete its entry" in line
    assert complaints({"Place": ["a.py", "b.py"]}, AcceptedNames({}, {"Place": 3})) != []


def test_a_name_has_one_entry() -> None:
    (line,) = complaints({"Place": ["a.py", "b.py"]}, AcceptedNames({"Place": 2}, {"Place": 2}))
    assert "keep one entry" in line


def test_an_allowed_name_needs_a_reason() -> None:
    with pytest.raises(ValueError, match="needs a reason"):
        read_lists('[allowed]\nPlace = { places = 2, why = " " }\n[to_rename]\n')


def test_the_list_of_names_to_rename_only_gets_shorter() -> None:
    assert len(read_lists(class_names.LISTS.read_text()).to_rename) <= NAMES_TO_RENAME_AT_FIRST
