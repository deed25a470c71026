"""The latest changes of the directory, as watches read them."""

from stampede_rt_supernode.core.change_ring import ChangeRing
from stampede_rt_supernode.core.records import ChangeKind, DirectoryChange, HostRecord

HOST = HostRecord(
    host_id=b"", name="h", gatekeepers=(), boot_incarnation=1, version="", alive=True, channels=0, registered_index=0
)


def ring_of(*indexes: int, changes_max: int = 4, floor: int = 0) -> ChangeRing:
    ring = ChangeRing(floor, changes_max=changes_max)
    for index in indexes:
        ring.append(DirectoryChange(index=index, kind=ChangeKind.UPDATED, subject=HOST))
        ring.note_index(index)
    return ring


def read(ring: ChangeRing, position: int, most: int = 100) -> tuple[list[int], int]:
    page = ring.read(position, most)
    assert page is not None
    return [change.index for change in page.changes], page.index


def test_a_reader_gets_every_change_once_and_in_order() -> None:
    ring = ring_of(3, 3, 5, 9)
    position = ring.position_after(3)
    assert position is not None
    assert read(ring, position) == ([5, 9], 9)
    assert read(ring, ring.end_position) == ([], 9)
    ring.note_index(12)
    assert read(ring, ring.end_position) == ([], 12)


def test_the_index_of_a_page_that_splits_a_log_position_is_below_it() -> None:
    ring = ring_of(3, 5, 5, 9)
    assert read(ring, 0, most=2) == ([3, 5], 4)
    assert read(ring, 2, most=1) == ([5], 8)


def test_a_reader_that_lags_too_far_gets_an_error() -> None:
    ring = ring_of(1, 2, 3, 4, 5, 6)
    assert ring.floor_index == 2
    assert ring.read(1, 10) is None
    assert ring.position_after(1) is None
    assert read(ring, ring.position_after(2) or 0) == ([3, 4, 5, 6], 6)


def test_a_watch_cannot_continue_from_an_index_whose_later_changes_are_partly_dropped() -> None:
    ring = ring_of(1, 2, 2, 2, 2, 2, changes_max=3)
    assert ring.position_after(1) is None
    assert ring.position_after(2) == ring.end_position


def test_changes_before_a_restored_snapshot_cannot_be_read() -> None:
    ring = ring_of(floor=40)
    assert ring.position_after(39) is None
    assert ring.position_after(40) == 0
