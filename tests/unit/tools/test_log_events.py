"""The check of the events in the services' logs."""

from __future__ import annotations

from tools.log_events import complaints

PAGE = """
### Events

| event | level | meaning |
| --- | --- | --- |
| `begun` | info | it begins |
| `other` | any | a line of a library |

## Next
"""
CALL = "def f():\n    logger.info('it begins'{extra})\n"


def check(extra: str, page: str = PAGE) -> list[str]:
    return complaints([("a.py", CALL.replace("{extra}", extra))], page)


def test_a_line_with_a_listed_event_is_right() -> None:
    assert check(", extra={'event': 'begun', 'a': 1}") == []


def test_a_line_without_an_event_is_named_with_its_place() -> None:
    for extra in ("", ", extra={'a': 1}", ", extra=facts"):
        assert any(line.startswith("a.py:2: the line of the log names no event") for line in check(extra)), extra


def test_an_event_may_be_in_a_dictionary_that_the_function_makes() -> None:
    module = "def f():\n    facts = {'event': 'begun'}\n    logger.warning('it begins', extra=facts)\n"
    assert complaints([("a.py", module)], PAGE) == []


def test_the_page_lists_the_events_that_are_logged_and_no_others() -> None:
    assert check(", extra={'event': 'ended'}") == [
        "docs/observing.md does not explain the event ended",
        "docs/observing.md explains the event begun, which nothing logs",
    ]
    assert check(
        ", extra={'event': 'begun'}", PAGE.replace("\n\n## Next", "\n| `begun` | info | again |\n\n## Next")
    ) == ["docs/observing.md explains the event begun twice"]
