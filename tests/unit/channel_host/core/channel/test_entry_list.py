"""The list of index entries against a plain sorted list, in chunks of four entries."""

from __future__ import annotations

from operator import attrgetter

import pytest
from hypothesis import given, strategies

from stampede_rt_channel_host.core.channel import entry_list
from stampede_rt_channel_host.core.channel.entry_list import EntryList
from stampede_rt_channel_host.core.channel.run import SingleItemRun

times = strategies.lists(strategies.integers(0, 12), max_size=60)
keys = strategies.integers(-1, 13)


def filled(added: list[int]) -> tuple[EntryList, list[SingleItemRun]]:
    """Return a list with an entry for each time, in the order of seqs, and the sorted entries."""
    made = EntryList(attrgetter("first_time"))
    entries = [SingleItemRun(seq, time, -1, 1, b"") for seq, time in enumerate(added, 1)]
    for entry in entries:
        made.add(entry)
    return made, sorted(entries, key=attrgetter("first_time"))


@pytest.fixture(autouse=True, scope="module")
def small_chunks() -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(entry_list, "CHUNK_ENTRIES", 4)
        yield


@given(times, keys)
def test_a_list_finds_the_neighbours_of_a_key(added: list[int], key: int) -> None:
    made, entries = filled(added)
    assert [*made] == entries
    assert (made.first, len(made)) == (entries[0] if entries else None, len(entries))
    assert made.last_up_to(key) is next((one for one in reversed(entries) if one.first_time <= key), None)
    assert made.last_below(key) is next((one for one in reversed(entries) if one.first_time < key), None)
    last = made.last_up_to(key)
    is_only = last is not None and [one.first_time for one in entries].count(last.first_time) == 1
    later = next((one.first_time for one in entries if one.first_time > key), None)
    assert made.only_up_to(key) == ((last, later) if is_only else None)
    assert made.last is (entries[-1] if entries else None)
    assert made.first_above(key) is next((one for one in entries if one.first_time > key), None)
    assert [made.nth(at) for at in range(len(entries) + 1)] == [*entries, None]


@given(times, keys, keys, strategies.integers(0, 61))
def test_a_range_has_all_entries_between_two_keys_except_entries_below_a_seq(
    added: list[int], low: int, high: int, seq: int
) -> None:
    made, entries = filled(added)
    whole = [one for one in entries if low <= one.first_time <= high]
    assert [*made.between(low, high)] == whole
    assert [*made.between_down(low, high)] == whole[::-1]
    found = [*made.between(low, high, seq)]
    assert found == whole[len(whole) - len(found) :]
    wanted = [one for one in whole if (one.first_time, one.first_seq) >= (low, seq)]
    assert found[len(found) - len(wanted) :] == wanted
    assert len(found) <= len(wanted) + 1
    down = [*made.between_down(low, high, seq)]
    wanted = [one for one in whole if (one.first_time, one.first_seq) <= (high, seq)]
    assert down[len(down) - len(wanted) :] == wanted[::-1]
    assert len(down) <= len(wanted) + 1


@given(times, strategies.data())
def test_entries_leave_from_the_front_and_from_anywhere(added: list[int], data: strategies.DataObject) -> None:
    made, entries = filled(added)
    while entries:
        if data.draw(strategies.booleans()):
            entries.pop(0)
            made.remove_first()
        else:
            made.remove(entries.pop(data.draw(strategies.integers(0, len(entries) - 1))))
        assert ([*made], len(made)) == (entries, len(entries))
        assert [*made.between(-1, 13)] == entries
        last = SingleItemRun(len(added) + 1, 5, -1, 1, b"")
        made.add(last)
        assert made.last_up_to(5) is last
        made.remove(last)
