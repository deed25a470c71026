"""The check for docstrings, comments and names of tests that begin with a clause without its noun."""

from __future__ import annotations

import pytest

from tools.plain_words import complaints, complaints_about_lines


@pytest.mark.parametrize(
    "text",
    [
        "What was collected.",
        "Whose turn it is.",
        "Of two items the later one.",
        "Tell whoever asks.",
        "Earlier, it waited.",
        "List the segments. `epoch`: of the channel.",
        "List the segments. `epoch`: the channel's, at present.",
        "As `read`, in pieces.",
    ],
)
def test_a_docstring_without_its_noun_is_found(text: str) -> None:
    (line,) = complaints("a.py", f'def f():\n    """{text}"""\n')
    assert line.startswith("a.py:2: name the noun instead of")


@pytest.mark.parametrize(
    "text", ["The collected items.", "Who leads?", "Whatsoever.", "Earlier items count.", "Offers an item."]
)
def test_other_docstrings_pass(text: str) -> None:
    assert list(complaints("a.py", f'"""{text}"""\n')) == []


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("test_what_goes_is_counted", "what"),
        ("test_who_waits_is_served", "who"),
        ("test_one_that_is_missing_is_replaced", "one_that"),
        ("test_messages_come_to_whoever_asks", "whoever"),
        ("test_a_read_passes_whatever_the_rules", "whatever"),
        ("test_a_host_serves_its_own_items_and_those_of_others", "those"),
        ("test_a_check_says_what_failed", "what"),
    ],
)
def test_a_name_of_a_test_without_its_noun_is_found(name: str, words: str) -> None:
    (line,) = complaints("a.py", f"async def {name}(): ...\n")
    assert line.startswith(f'a.py:1: name the noun instead of "{words}"')


@pytest.mark.parametrize("name", ["test_an_item_that_goes_is_counted", "test_one_owner_keeps_it", "what_goes"])
def test_other_names_pass(name: str) -> None:
    assert list(complaints("a.py", f"def {name}(): ...\n")) == []


@pytest.mark.parametrize(
    "source",
    [
        '"""It ends at{} once."""', '"""It ends at{}\n    once."""', "# It ends at{}\n# once.",
        "def take_at{}_once(): ...", "MOVES_AT{}_ONCE = 2", "class At{}Once: ...",
    ],
)  # fmt: skip
def test_words_with_two_meanings_are_found(source: str) -> None:
    (line,) = complaints("a.py", source.format(""))
    assert line.startswith('a.py:1: say "immediately" or "at the same time" instead of')


@pytest.mark.parametrize("source", ["# that once was", "x = great_once", "at_onces = 1"])
def test_parts_of_other_words_pass(source: str) -> None:
    assert list(complaints("a.py", source)) == []


@pytest.mark.parametrize(
    ("start", "words"), [("MOST = 16  #", "of one request"), ("#", "Those of others."), ("x = 1  #:", "What it is")]
)
def test_a_comment_without_its_noun_is_found(start: str, words: str) -> None:
    (line,) = complaints("a.py", f"{start} {words}\nx = 1\n")
    assert line.startswith("a.py:1: name the noun instead of")


@pytest.mark.parametrize(
    "source", ["# The most\n# of one request.\nx = 1\n", 'x = "# of"\n', "x = 1  # offers, if any\n"]
)
def test_other_comments_pass(source: str) -> None:
    assert list(complaints("a.py", source)) == []


@pytest.mark.parametrize(
    "source",
    [
        "told = 1",
        "again = 1",
        "self.said = 1",
        "self._asked = 1",
        "def f(heard): pass",
        "lambda told: told",
        "def _go_on(): ...",
        "of_queues = 1",
        "self._of_lease, x = y",
        "for of_kind in x: pass",
    ],
)
def test_a_name_without_a_meaning_is_found(source: str) -> None:
    (line,) = complaints("a.py", source)
    assert line.startswith("a.py:1: name the thing that ")


@pytest.mark.parametrize(
    "source", ["print(told)", "heard_at = 1", "def tell(): pass", "x.news()", "f(of_queues=1)", "def of_most(): ..."]
)
def test_other_names_of_variables_and_functions_pass(source: str) -> None:
    assert list(complaints("a.py", source)) == []


def test_a_comment_of_the_contract_names_its_subject() -> None:
    contract = "\n".join(
        ["message A {", "// It can serve", "// what it has.", "bool a = 1;", "// The host", "// It feeds."]
    )
    (line,) = complaints_about_lines("a.proto", contract)
    assert line.startswith('a.proto:2: name the noun instead of "It"')
