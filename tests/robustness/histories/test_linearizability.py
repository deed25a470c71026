"""The checker finds the planted violations, and none in correct histories."""

from __future__ import annotations

import random

import pytest

from tests.robustness.histories.channel_model import (
    ChannelModel,
    Delete,
    DeletedChannel,
    ExistingChannel,
    NoChannel,
    Open,
    Refusal,
    Resolve,
    SeenChannel,
    Update,
    acknowledged_writes,
    check_channel_histories,
)
from tests.robustness.histories.linearizability import NotLinearizable, SearchGivenUp, check_linearizable
from tests.robustness.histories.operations import Operation

A, B = b"a" * 16, b"b" * 16
NOT_FOUND = Refusal("CHANNEL_NOT_FOUND")


def op(call: object, invoked: float, returned: float | None, answer: object = None) -> Operation:
    return Operation("cam", call, invoked, *(() if returned is None else (returned, answer)))  # type: ignore[arg-type]


CREATED = op(Open(1), 0, 1, SeenChannel(A, 1, 1, 1, created=True))


def seen(value: int, version: int, *, epoch: int = 1, channel_id: bytes = A) -> SeenChannel:
    return SeenChannel(channel_id, epoch, value, version)


@pytest.mark.parametrize(
    "history",
    [
        [],
        [CREATED, op(Resolve(), 2, 3, seen(1, 1))],
        [op(Resolve(), 0, 1, NOT_FOUND), op(Open(1), 0, 1, SeenChannel(A, 1, 1, 1, created=True))],
        # Two creators together: one created it, the other got the same channel.
        [op(Open(7), 0, 9, seen(1, 1)), op(Open(1), 1, 8, SeenChannel(A, 1, 1, 1, created=True))],
        # During an update, one reader sees the old value and another one the new value.
        [
            CREATED,
            op(Update(A, 1, 2), 2, 9, seen(2, 2)),
            op(Resolve(), 3, 4, seen(1, 1)),
            op(Resolve(), 5, 6, seen(2, 2)),
        ],
        # An update with a lost answer takes effect much later, or never.
        [CREATED, op(Update(A, 1, 2), 2, None), op(Resolve(), 3, 4, seen(1, 1)), op(Resolve(), 5, 6, seen(2, 2))],
        [CREATED, op(Update(A, 1, 2), 2, None), op(Resolve(), 3, 4, seen(1, 1))],
        # A creation with a lost answer.
        [op(Open(1), 0, None), op(Resolve(), 2, 3, seen(1, 1, channel_id=B))],
        [CREATED, op(Delete(A), 2, 3, DeletedChannel()), op(Resolve(), 4, 5, NOT_FOUND)],
        [CREATED, op(Delete(A), 2, 3, DeletedChannel()), op(Open(2), 4, 5, SeenChannel(B, 1, 2, 1, created=True))],
        # The channel got another owner in between.
        [CREATED, op(Resolve(), 2, 3, seen(1, 1, epoch=2)), op(Update(A, 1, 3), 4, 5, Refusal("WRONG_EPOCH"))],
    ],
)
def test_a_history_that_some_order_explains_is_accepted(history: list[Operation]) -> None:
    check_channel_histories(history)


@pytest.mark.parametrize(
    "history",
    [
        # An acknowledged write is lost.
        [CREATED, op(Update(A, 1, 2), 2, 3, seen(2, 2)), op(Resolve(), 4, 5, seen(1, 1))],
        [CREATED, op(Resolve(), 2, 3, NOT_FOUND)],
        # Two creators both created the channel.
        [CREATED, op(Open(2), 0, 1, SeenChannel(B, 1, 2, 1, created=True))],
        # A value changes back between two reads.
        [CREATED, op(Update(A, 1, 2), 2, None), op(Resolve(), 3, 4, seen(2, 2)), op(Resolve(), 5, 6, seen(1, 1))],
        # The update took effect twice: the version shows it.
        [CREATED, op(Update(A, 1, 2), 2, 3, seen(2, 2)), op(Resolve(), 4, 5, seen(2, 3))],
        # The call had an effect although its caller was told that it had none (so the history leaves it out).
        [CREATED, op(Resolve(), 2, 3, seen(9, 2))],
        # The epoch falls.
        [CREATED, op(Resolve(), 2, 3, seen(1, 1, epoch=3)), op(Resolve(), 4, 5, seen(1, 1, epoch=2))],
        # An update under an epoch that had passed.
        [CREATED, op(Resolve(), 2, 3, seen(1, 1, epoch=2)), op(Update(A, 1, 5), 4, 5, seen(5, 2, epoch=1))],
        # The channel was deleted, and is still there.
        [CREATED, op(Delete(A), 2, 3, DeletedChannel()), op(Resolve(), 4, 5, seen(1, 1))],
        # An effect before its cause.
        [CREATED, op(Resolve(), 2, 3, seen(2, 2)), op(Update(A, 1, 2), 4, 5, seen(2, 2))],
        # The id of a later creation cannot come from an earlier one with a lost answer.
        [
            op(Open(1), 0, None),
            op(Resolve(), 1, 2, seen(1, 1)),
            op(Open(1), 3, 4, SeenChannel(A, 1, 1, 1, created=True)),
        ],
    ],
)
def test_a_planted_violation_is_found(history: list[Operation]) -> None:
    with pytest.raises(NotLinearizable, match="no order of these operations"):
        check_channel_histories(history)


def run_of_one_object(rng: random.Random, *, callers: int = 5, length: int = 60) -> list[Operation]:
    """A correct history: every call takes effect at one moment between its times; some answers are lost."""
    model: list[tuple[float, float, float, object]] = []
    for caller in range(callers):
        now = rng.random()
        for number in range(length // callers):
            invoked, moment, returned = now, now + rng.random(), now + 2 * rng.random() + 1
            kind = rng.random()
            value = 1000 * caller + number + 10
            model.append((moment, invoked, returned, Resolve() if kind < 0.4 else Open(1) if kind < 0.5 else value))
            now = returned
    state: ExistingChannel | None = None
    history, ids = [], 0
    for moment, invoked, returned, what in sorted(model, key=lambda one: one[0]):
        call, answer = what, None
        if isinstance(what, Open) and state is None:
            ids += 1
            state = ExistingChannel(ids.to_bytes(16, "big"), 1, 1, 1)
            answer = SeenChannel(state.channel_id or b"", 1, 1, 1, created=True)
        elif isinstance(what, int):
            if state is None or state.channel_id is None:
                continue
            call = Update(state.channel_id, 1, what)
            state = ExistingChannel(state.channel_id, 1, what, state.version + 1)
        if answer is None:
            answer = SeenChannel(state.channel_id or b"", 1, state.value, state.version) if state else NOT_FOUND
        if rng.random() < 0.15:
            history.append(Operation("cam", call, invoked))
        else:
            history.append(Operation("cam", call, invoked, max(returned, moment), answer))
    return history


@pytest.mark.parametrize("seed", range(30))
def test_true_histories_are_accepted_and_spoilt_ones_are_not(seed: int) -> None:
    rng = random.Random(seed)
    history = run_of_one_object(rng)
    check_channel_histories(history)
    reads = [
        number
        for number, one in enumerate(history)
        if isinstance(one.call, Resolve) and isinstance(one.answer, SeenChannel)
    ]
    if not reads:
        return
    spoilt = rng.choice(reads)
    one = history[spoilt]
    assert isinstance(one.answer, SeenChannel)
    wrong = SeenChannel(one.answer.channel_id, 1, one.answer.value, one.answer.version + 1)
    history[spoilt] = Operation(one.key, one.call, one.invoked, one.returned, wrong)
    with pytest.raises(NotLinearizable):
        check_channel_histories(history)


def test_a_search_that_grows_too_large_is_reported_as_undecided() -> None:
    history = [Operation("cam", Update(A, 1, value), 0.0) for value in range(2, 30)]
    history += [CREATED, op(Resolve(), 2, 3, seen(99, 9))]
    with pytest.raises(SearchGivenUp, match="more than 500"):
        check_linearizable(history, NoChannel(), ChannelModel().step, configurations_max=500)


def test_the_history_of_each_name_is_checked_separately() -> None:
    other = Operation("mic", Open(1), 0, 1, SeenChannel(B, 1, 1, 1, created=True))
    history = [CREATED, other, op(Update(A, 1, 2), 2, 3, seen(2, 2)), op(Update(A, 1, 3), 2, None)]
    assert check_channel_histories(history) == 2
    assert acknowledged_writes(history) == 3
