"""Pages of names that match a pattern."""

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt_supernode.core import page_tokens, queries
from stampede_rt_supernode.core.glob import matcher
from stampede_rt_supernode.core.queries import channel_page, channels_of, host_page
from tests.support.supernode.operations import Log, deregister, id_of, open_channel, register


@pytest.fixture
def log() -> Log:
    log = Log()
    for number, name in enumerate(("b", "a", "c"), start=1):
        log.apply(register(number, name=name))
    for name in ("cam/left", "cam/right", "cam/top/far", "mic", "camera"):
        log.apply(open_channel(name))
    return log


def names(log: Log, glob: str, after: str = "", size: int = 0) -> list[str]:
    return [channel.name for channel in channel_page(log.directory.tables, glob, after, size).channels]


@pytest.mark.parametrize(
    ("glob", "expected"),
    [
        ("", ["cam/left", "cam/right", "cam/top/far", "camera", "mic"]),
        ("*", ["cam/left", "cam/right", "cam/top/far", "camera", "mic"]),
        ("cam/*", ["cam/left", "cam/right", "cam/top/far"]),
        ("*r*", ["cam/right", "cam/top/far", "camera"]),
        ("m?c", ["mic"]),
        ("mic", ["mic"]),
        ("Cam*", []),
        ("nothing*", []),
    ],
)
def test_a_pattern_lists_the_matching_names_in_order(log: Log, glob: str, expected: list[str]) -> None:
    assert names(log, glob) == expected


def test_pages_continue_where_the_last_one_ended(log: Log) -> None:
    seen, after, pages = [], "", 0
    while True:
        page = channel_page(log.directory.tables, "cam*", after, 2)
        seen += [channel.name for channel in page.channels]
        pages += 1
        if page.last_name is None:
            break
        after = page_tokens.read_name(page_tokens.write_name(page.last_name))
    assert (seen, pages) == (["cam/left", "cam/right", "cam/top/far", "camera"], 2)


def test_a_page_looks_at_a_bounded_number_of_names(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(queries, "NAMES_EXAMINED_MAX", 2)
    page = channel_page(log.directory.tables, "*mic", "", 0)
    assert page.channels == ()
    assert page.last_name == "cam/right"
    assert names(log, "*mic", after="camera") == ["mic"]


@pytest.mark.parametrize("glob", ["CÄM", "cam[ab]", "cam\n", "x" * 257])
def test_a_pattern_that_can_match_nothing_is_refused(glob: str) -> None:
    with pytest.raises(InvalidArgument, match=r"pattern|match no channel"):
        matcher(glob)


def test_hosts_are_listed_by_name_and_dead_ones_only_on_request(log: Log) -> None:
    log.apply(deregister(1))
    tables = log.directory.tables
    assert [host.name for host in host_page(tables, ("", b""), 0, include_dead=False).hosts] == ["a", "c"]
    first = host_page(tables, ("", b""), 2, include_dead=True)
    assert [host.name for host in first.hosts] == ["a", "b"]
    after = page_tokens.read_host(page_tokens.write_host(first.last_key))
    assert [host.name for host in host_page(tables, after, 2, include_dead=True).hosts] == ["c"]


def test_a_last_page_that_is_full_has_no_token(log: Log) -> None:
    assert host_page(log.directory.tables, ("", b""), 3, include_dead=True).last_key is None


def test_the_channels_of_a_host_are_bounded(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(channels_of(log.directory.tables, id_of(2))) == 2
    monkeypatch.setattr(queries, "HOST_CHANNELS_MAX", 1)
    assert len(channels_of(log.directory.tables, id_of(2))) == 1


@pytest.mark.parametrize("token", ["!", "abc", "_w=="])
def test_a_text_that_is_no_page_token_is_refused(token: str) -> None:
    with pytest.raises(InvalidArgument, match="page token"):
        page_tokens.read_name(token)
