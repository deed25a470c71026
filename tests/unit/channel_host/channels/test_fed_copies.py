"""How the host of a channel spreads its readers over the copies that it feeds."""

from __future__ import annotations

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels import fed_copies
from stampede_rt_channel_host.channels.fed_copies import READERS_MOVED_MAX, FedCopies, FedCopy
from stampede_rt_channel_host.channels.observers import ChangeObserver, Observers


class Reader(ChangeObserver):
    def __init__(self, observers: Observers, *, may_move: bool = True) -> None:
        super().__init__()
        self._may_move = may_move
        self._observers = observers
        self.sent_to = ""
        observers.add(self)

    @property
    def may_move(self) -> bool:
        return self._may_move

    def end(self, error: StampedeError) -> None:
        self.sent_to = error.metadata["copy_target"]
        self._observers.discard(self)


def copy_with(subscriptions: int, target: str = "h2:1", *, ready: bool = True) -> FedCopy:
    copy = FedCopy(target.encode(), target, lambda: 0)
    copy.report(subscriptions, ready=ready)
    return copy


def fed(*copies: FedCopy) -> FedCopies:
    made = FedCopies()
    for one in copies:
        made.add(one)
    return made


def test_a_new_reader_is_sent_to_the_copy_with_the_fewest_readers() -> None:
    copies = fed(copy_with(2, "h2:1"), copy_with(1, "h3:1"))
    assert copies.less_loaded("cam", 1) is None
    sent = copies.less_loaded("cam", 2)
    assert sent is not None
    assert (sent.reason, sent.metadata["copy_target"]) == ("MOVED", "h3:1")


def test_readers_that_arrive_together_are_counted_before_the_copy_reports_them() -> None:
    copies = fed(copy_with(0))
    assert [copies.less_loaded("cam", 3) is None for _ in range(4)] == [False, False, False, True]


def test_a_silent_copy_and_a_copy_that_is_not_ready_get_no_readers() -> None:
    assert fed(copy_with(0, ready=False)).less_loaded("cam", 9) is None
    assert fed(copy_with(0, ready=False)).for_gets() == ""
    silent = copy_with(0)
    silent.reported_nanos -= fed_copies.REPORT_AGE_NANOS_MAX + 1
    assert fed(silent).less_loaded("cam", 9) is None
    assert fed(silent).for_gets() == ""


def test_gets_use_the_copies_in_turn() -> None:
    copies = fed(copy_with(5, "h2:1"), copy_with(0, "h3:1"))
    assert {copies.for_gets(), copies.for_gets()} == {"h2:1", "h3:1"}


def test_a_host_sends_connected_readers_to_a_new_copy_until_both_have_their_share() -> None:
    observers, copy = Observers(), copy_with(0)
    readers = [Reader(observers) for _ in range(8)]
    fed(copy).relieve("cam", copy, observers)
    assert sum(one.sent_to == "h2:1" for one in readers) == 4
    copy.report(4, ready=True)
    fed(copy).relieve("cam", copy, observers)
    assert len(observers) == 4


def test_readers_that_require_the_owner_stay_and_only_a_few_others_move_at_a_time() -> None:
    observers, copy = Observers(), copy_with(0)
    staying = [Reader(observers, may_move=False) for _ in range(50)]
    moving = [Reader(observers) for _ in range(50)]
    fed(copy).relieve("cam", copy, observers)
    assert not any(one.sent_to for one in staying)
    assert sum(bool(one.sent_to) for one in moving) == READERS_MOVED_MAX


def test_small_differences_move_no_reader() -> None:
    observers, copy = Observers(), copy_with(3)
    readers = [Reader(observers) for _ in range(4)]
    fed(copy).relieve("cam", copy, observers)
    assert not any(one.sent_to for one in readers)


def test_a_new_copy_gets_readers_even_if_the_host_is_only_slightly_above_its_share() -> None:
    observers, new, old = Observers(), copy_with(0, "h3:1"), copy_with(3, "h2:1")
    readers = [Reader(observers) for _ in range(3)]
    fed(old, new).relieve("cam", new, observers)
    assert [one.sent_to for one in readers] == ["h3:1", "", ""]
