"""The check of the pages for newcomers: the named files exist, the picture is fresh, and the index is complete."""

from __future__ import annotations

import re
from typing import Any

import pytest

from stampede_rt.cli.verbs import SERVICE_VERBS, VERBS
from tools import signposts
from tools.signposts import BEGIN, END, ROOT, index_complaints, layers, merge_complaints, unknown_names, with_layers

FILES = ["client/src/stampede_rt/wire/runs.py", "docs/wire.md", "services/host/src/stampede_rt_host/core/__init__.py"]
LAYERED = {"name": "Down", "type": "layers", "layers": ["pkg.top", "pkg.a : pkg.b", "pkg.low"]}
SENTENCES_MAX = 4
COMMAND = re.compile(r"`stampede ([a-z][a-z-]*)")
SPANS = {"open", "enqueue", "take", "subscribe", "match"}  # traces have these names
GLOSSARY_ROW = re.compile(r"^\| ([^|]+) \| ([^|]+) \| `([\w.]+)` \|$", re.MULTILINE)


@pytest.mark.parametrize(
    "name", ["stampede_rt.wire.runs", "stampede_rt.wire", "wire/runs.py", "docs/wire.md", "stampede_rt_host/core/"]
)
def test_a_name_of_a_file_or_folder_is_known(name: str) -> None:
    assert unknown_names(f"see `{name}`", FILES) == []


@pytest.mark.parametrize(
    "name", ["stampede_rt.wire.run", "stampede_rt.core", "ire/runs.py", "runs.proto", "core/wire/"]
)
def test_a_name_without_a_file_is_reported(name: str) -> None:
    assert unknown_names(f"see `{name}`", FILES) == [name]


def test_a_folder_of_a_service_that_is_not_on_the_map_is_reported() -> None:
    files = [*FILES, "client/src/stampede_rt/v1/a_pb2.py", "client/src/stampede_rt/errors.py", "demos/src/demos/a/b.py"]
    assert signposts.unmapped_folders("  wire/   runs\n  core/   pure", files) == []
    assert signposts.unmapped_folders("  wire/   runs, core/", files) == ["services/host/src/stampede_rt_host/core"]


def test_a_picture_has_a_row_for_each_layer_from_the_top_down() -> None:
    assert layers([LAYERED]) == "Down\n    top\n  ↓ a, b\n  ↓ low"


@pytest.mark.parametrize(
    ("contract", "drawn"),
    [
        ({"name": "Apart", "type": "independence", "modules": ["a", "b"]}, "Apart\n    a | b"),
        (
            {"name": "Pure", "type": "forbidden", "source_modules": ["a", "b"], "forbidden_modules": ["time"]},
            "Pure\n    a, b\n    ✗ do not import\n    time",
        ),
    ],
)
def test_a_layer_picture_shows_the_other_rules_too(contract: dict[str, Any], drawn: str) -> None:
    assert layers([contract]) == drawn


def test_a_new_picture_takes_the_place_of_the_old_one() -> None:
    page = with_layers(f"before\n{BEGIN}\nold\n{END}\nafter", "new")
    assert page == f"before\n{BEGIN}\n\n```\nnew\n```\n\n{END}\nafter"
    assert with_layers(page, "new") == page
    with pytest.raises(ValueError, match="needs the two lines"):
        with_layers("no marks", "new")


@pytest.mark.parametrize(
    ("index", "expected"),
    [
        ("| [0001](0001-a.md) | A | a |", "0002-b.md is not in the index"),
        ("| [0001](0001-a.md) | A | a |\n| [0002](0002-b.md) | B | b |\n| [0003](0003-c.md) | C | c |", "0003-c.md"),
        ("| [0001](0001-a.md) | A | a |\n| [0003](0002-b.md) | B | b |", "calls 0002-b.md number 0003"),
        ("| [0002](0002-b.md) | B | b |\n| [0001](0001-a.md) | A | a |", "not in the order"),
    ],
)
def test_an_index_that_is_not_complete_and_in_order_is_reported(index: str, expected: str) -> None:
    (line,) = index_complaints(index, {"0001-a.md": "", "0002-b.md": ""})
    assert expected in line


def test_a_page_with_the_marks_of_a_merge_conflict_is_reported() -> None:
    conflict = "| a |\n<<<<<<< HEAD\n| b |\n=======\n| c |\n>>>>>>> 1234567 (Say more)\n"
    (line,) = merge_complaints({"docs/a.md": conflict, "docs/b.md": "a < b, and <<<<<<< in a sentence\n=======\n"})
    assert "docs/a.md" in line


def test_the_glossary_explains_each_term_once_in_at_most_four_sentences() -> None:
    page = (ROOT / "docs/glossary.md").read_text()
    rows = GLOSSARY_ROW.findall(page)
    assert len(rows) == sum(line.startswith("| ") for line in page.splitlines()) - 2 * page.count("| term |")
    terms = [term for term, _, _ in rows]
    assert len(set(terms)) == len(terms)
    for section in page.split("\n## ")[1:]:
        listed = [term for term, _, _ in GLOSSARY_ROW.findall(section)]
        assert listed == sorted(listed)
    for term, meaning, _ in rows:
        assert meaning.endswith("."), term
        assert meaning.count(". ") < SENTENCES_MAX, term


def test_every_term_that_the_glossary_refers_to_has_an_entry() -> None:
    rows = GLOSSARY_ROW.findall((ROOT / "docs/glossary.md").read_text())
    forms = {form for term, _, _ in rows for form in forms_of(term.split(" (")[0])}
    for term, meaning, _ in rows:
        for other in re.findall(r"\*([\w' -]+)\*", meaning):
            assert other.lower() in forms, f"{term} refers to {other}"


def forms_of(term: str) -> set[str]:
    """A term, its plural, its genitive and its participle."""
    return {term, f"{term}s", f"{term.removesuffix('y')}ies", f"{term}'s", f"{term}d"}


def test_the_way_for_newcomers_is_short() -> None:
    assert len((ROOT / "docs/finding-your-way.md").read_text().splitlines()) <= 60


def test_pages_and_errors_name_existing_verbs() -> None:
    folders = ("client", "services", "web", "deploy", "demos", "benchmarks")
    files = [path for folder in folders for path in (ROOT / folder).glob("**/src/**/*.py")]
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
    named = {
        (path.name, verb) for path in [*files, *pages] for verb in COMMAND.findall(path.read_text(encoding="utf-8"))
    }
    spans = {("observing.md", span) for span in SPANS}
    assert {(name, verb) for name, verb in named - spans if verb not in VERBS and verb not in SERVICE_VERBS} == set()
