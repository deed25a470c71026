"""A list in the order of a key answers as a sorted list does."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_channel_host.core.keyed_list import Key, KeyedList

keys = st.tuples(st.integers(0, 5), st.integers(0, 5))


@given(st.lists(keys, unique=True), st.lists(st.integers(0, 40)), st.none() | keys, keys, st.integers(0, 6))
def test_a_keyed_list_is_in_the_order_of_keys_and_not_of_additions(
    added: list[Key], removed: list[int], last: Key | None, end: Key, things_max: int
) -> None:
    listed: KeyedList[Key] = KeyedList(lambda key: key)
    for key in added:
        listed.add(key)
    left = sorted(added)
    for at in removed:
        if left:
            listed.remove(left.pop(at % len(left)))
    assert [listed[at] for at in range(len(listed))] == left
    within = [key for key in left if (last is None or key > last) and key <= end]
    assert listed.after(last, end, things_max) == within[:things_max]
