"""How far a host may send ahead of a reader."""

from __future__ import annotations

from stampede_rt.pacing.crediting import (
    ITEM_OVERHEAD_BYTES,
    ONE_ITEM,
    QUICK_S,
    WINDOW_AGE_S,
    WINDOW_BYTES_MAX,
    CreditWindow,
    cost_of,
)
from stampede_rt.values.model import Item

FRAME = 18_000


class Reader:
    """Takes items, each in a stated time. All items are available from the start."""

    def __init__(self, window: CreditWindow, item_bytes: int) -> None:
        self.window = window
        self.item_bytes = item_bytes
        self.now_s = 0.0
        self.left = 0  # the credit that the host has left
        self.on_the_way = 0
        self.messages = 0

    def step(self, busy_s: float) -> None:
        credit = self.window.ask(self.now_s)
        self.messages += bool(credit)
        self.left += credit
        while self.left > 0:
            self.left -= self.item_bytes
            self.on_the_way += 1
        assert self.on_the_way, "the reader asked, and the host may send nothing"
        self.on_the_way -= 1
        self.window.take(self.item_bytes, self.now_s)
        self.now_s += busy_s


def test_the_credit_begins_with_one_item_and_doubles_for_a_reader_that_keeps_up() -> None:
    reader = Reader(CreditWindow(), FRAME)
    ahead = []
    for _ in range(12):
        reader.step(1e-6)
        ahead.append(reader.on_the_way)
    assert ahead[:4] == [0, 1, 3, 7]
    assert max(ahead) * FRAME <= WINDOW_BYTES_MAX


def test_the_credit_of_a_slow_reader_covers_at_most_a_tenth_of_a_second() -> None:
    reader = Reader(CreditWindow(), 100)
    for _ in range(30):
        reader.step(1e-6)
    for _ in range(20_000):
        reader.step(0.005)
    assert reader.on_the_way <= WINDOW_AGE_S / 0.005
    for _ in range(100):
        reader.step(1.0)
    assert reader.on_the_way == 0


def test_a_reader_gets_its_full_credit_back_after_one_slow_step() -> None:
    reader = Reader(CreditWindow(), FRAME)
    for busy_s in (1e-6, 1e-6, 1e-6, 5.0, *[1e-6] * 20):
        reader.step(busy_s)
    assert reader.on_the_way > 20


def test_with_one_item_nothing_is_sent_before_the_reader_asks() -> None:
    for busy_s in (0.0, 1e-6, 1.0):
        reader = Reader(CreditWindow(ONE_ITEM), FRAME)
        for _ in range(10):
            reader.step(busy_s)
            assert reader.on_the_way == 0


def test_a_quick_reader_grants_credit_in_few_messages() -> None:
    reader = Reader(CreditWindow(), 100)
    for _ in range(100_000):
        reader.step(1e-6)
    assert reader.messages < 100


def test_credit_that_is_asked_for_twice_is_granted_once() -> None:
    window = CreditWindow()
    assert window.ask(0.0) == 1
    assert window.ask(1.0) == 0
    window.begin()  # as on a new stream
    assert window.ask(2.0) == 1


def test_an_item_that_the_reader_has_already_makes_room_for_another() -> None:
    window = CreditWindow(ONE_ITEM)
    assert window.ask(0.0) == 1
    window.drop(164)
    assert window.ask(0.0) == 164


def test_items_that_were_taken_together_leave_the_same_credit_as_one_after_the_other() -> None:
    together, apart = CreditWindow(), CreditWindow()
    for window in (together, apart):
        window.ask(0.0)
        window.take(FRAME, 1.0)
        window.ask(1.0)
    for at in range(3):
        apart.take(FRAME + at, 1.0 + at / 1000)
    together.take_all(3 * FRAME + 3, FRAME + 2, 1.002)
    assert together.ask(1.01) == apart.ask(1.01) > 0


def test_a_reader_that_works_long_on_batches_asks_for_one_response_at_a_time() -> None:
    window = CreditWindow()
    assert (window.ask(0.0, for_batch=True), window.is_for_one) == (1, False)
    window.take_all(FRAME, FRAME, 1.0)
    assert (window.ask(1.0 + QUICK_S / 2, for_batch=True), window.is_for_one) == (2 * FRAME + FRAME - 1, False)
    for now_s in (2.0, 3.0):
        window.take_all(FRAME, FRAME, now_s)
        assert (window.ask(now_s + 2 * QUICK_S, for_batch=True), window.is_for_one) == (WINDOW_BYTES_MAX, True)
    window.take_all(FRAME, FRAME, 4.0)
    assert (window.ask(4.0), window.is_for_one) == (2 * 2 * FRAME, False)  # the host has dropped the rest


def test_a_reader_of_large_batches_that_takes_a_full_window_in_time_reads_ahead() -> None:
    window = CreditWindow()
    window.ask(0.0)
    window.take_all(WINDOW_BYTES_MAX, WINDOW_BYTES_MAX, 1.0)
    assert window.ask(1.0 + WINDOW_AGE_S / 2, for_batch=True) > 0
    assert not window.is_for_one


def test_a_reader_of_the_newest_item_asks_for_one_item_also_in_batches() -> None:
    window = CreditWindow(ONE_ITEM)
    window.ask(0.0)
    window.take(FRAME, 0.0)
    assert (window.ask(1.0, for_batch=True), window.is_for_one) == (FRAME, False)


def test_an_item_costs_its_payload_and_64_bytes_also_without_the_payload() -> None:
    one = Item(1, None, None, 1, None, {}, "", FRAME, 1)
    assert cost_of([one, one._replace(payload_length_bytes=0)]) == FRAME + 2 * ITEM_OVERHEAD_BYTES
    assert cost_of([]) == 0
