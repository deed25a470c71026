"""The check of the names that modules of the tests import from each other."""

from __future__ import annotations

from tools.imported_names import complaints, main

RIG = "LIMIT = 1\nasync def serve(): ...\nclass Rig: ..."


def test_an_import_of_a_name_that_does_not_exist_is_found() -> None:
    importer = "import os\nfrom tests.rig import LIMIT, Cluster, Rig, serve"
    assert complaints({"tests.rig": RIG, "tests.user": importer}) == ["tests.user, line 2: tests.rig has no Cluster"]


def test_an_import_from_a_module_that_does_not_exist_is_found() -> None:
    assert complaints({"tests.user": "from tests.gone import x"}) == ["tests.user, line 1: tests.gone has no x"]


def test_a_module_can_be_imported_from_its_package() -> None:
    modules = {"tests.a": "", "tests.a.rig": RIG, "tests.user": "from tests.a import rig\nfrom tests import a"}
    assert complaints(modules) == []


def test_each_name_that_the_tests_import_exists() -> None:
    assert main() == 0
