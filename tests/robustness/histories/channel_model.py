"""The model of one name of the directory: the first caller that opens the name creates the channel, which holds a
value.

The value is the policy's `max_items`, because every caller can set and see it. `version` counts the changes, so that
the model notices an update that took effect twice. The epoch may rise at any moment, because leases end and hosts
restart. So the model only demands that it never falls.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TypeAlias

from tests.robustness.histories.linearizability import NotLinearizable, SearchGivenUp, check_linearizable
from tests.robustness.histories.operations import Operation, by_key


@dataclass(frozen=True, slots=True)
class Open:
    """Get or create. States `value` only if it is not 0."""

    value: int


@dataclass(frozen=True, slots=True)
class Resolve:
    """Find by name."""


@dataclass(frozen=True, slots=True)
class Update:
    """Set the value of the channel with that id, if it has that epoch."""

    channel_id: bytes
    epoch: int
    value: int


@dataclass(frozen=True, slots=True)
class Delete:
    """Delete the channel with that id."""

    channel_id: bytes


@dataclass(frozen=True, slots=True)
class SeenChannel:
    """The channel as an answer showed it."""

    channel_id: bytes
    epoch: int
    value: int
    version: int
    created: bool = False


@dataclass(frozen=True, slots=True)
class Refusal:
    """The directory refused the call for this reason."""

    reason: str


@dataclass(frozen=True, slots=True)
class DeletedChannel:
    """The channel was deleted."""


@dataclass(frozen=True, slots=True)
class NoChannel:
    """No channel has the name."""


@dataclass(frozen=True, slots=True)
class ExistingChannel:
    """The channel with the name.

    An id of None: the answer to its creation was lost, and no later answer has shown it.
    """

    channel_id: bytes | None
    epoch: int
    value: int
    version: int


State: TypeAlias = NoChannel | ExistingChannel


class ChannelModel:
    """The rules for one name.

    `created_ids`: the ids of acknowledged creations. No creation with a lost answer has one of them.
    """

    def __init__(self, created_ids: frozenset[bytes] = frozenset()) -> None:
        self._created_ids = created_ids

    def step(self, state: State, operation: Operation) -> State | None:
        """The state after `operation`; None if the operation cannot give this answer in `state`."""
        answer = operation.answer
        match operation.call:
            case Open(value=value):
                return self._open(state, value, answer)
            case Resolve():
                return self._resolve(state, answer)
            case Update():
                return self._update(state, operation.call, answer)
            case Delete(channel_id=channel_id):
                return self._delete(state, channel_id, answer)
        raise AssertionError(f"no such call: {operation.call}")

    def _open(self, state: State, value: int, answer: object) -> State | None:
        if isinstance(state, NoChannel):
            if answer is None:
                return ExistingChannel(None, 1, value, 1)
            if (
                isinstance(answer, SeenChannel)
                and answer.created
                and (answer.epoch, answer.value, answer.version)
                == (
                    1,
                    value,
                    1,
                )
            ):
                return ExistingChannel(answer.channel_id, 1, value, 1)
            return None
        if answer is None:
            return None  # an order without this call has the same effect
        return self._observe(state, answer) if isinstance(answer, SeenChannel) and not answer.created else None

    def _resolve(self, state: State, answer: object) -> State | None:
        if answer == Refusal("CHANNEL_NOT_FOUND"):
            return state if isinstance(state, NoChannel) else None
        return self._observe(state, answer) if isinstance(answer, SeenChannel) else None

    def _observe(self, state: State, seen: SeenChannel) -> State | None:
        if isinstance(state, NoChannel):
            return None
        known = self._bind(state, seen.channel_id, seen.epoch)
        if known is None or (known.epoch, known.value, known.version) != (seen.epoch, seen.value, seen.version):
            return None
        return known

    def _bind(self, state: ExistingChannel, channel_id: bytes, epoch: int) -> ExistingChannel | None:
        """The state with this id and at least this epoch; None if the state contradicts them."""
        if state.channel_id is None and channel_id in self._created_ids:
            return None
        if state.channel_id not in (None, channel_id):
            return None
        return replace(state, channel_id=channel_id, epoch=max(state.epoch, epoch))

    def _update(self, state: State, call: Update, answer: object) -> State | None:
        known = self._bind(state, call.channel_id, call.epoch) if isinstance(state, ExistingChannel) else None
        if answer == Refusal("CHANNEL_NOT_FOUND"):
            return self._without(state, call.channel_id)
        if answer == Refusal("WRONG_EPOCH"):
            # The epoch rose before, or at this moment. Callers name only epochs from answers.
            return replace(known, epoch=max(known.epoch, call.epoch + 1)) if known is not None else None
        if known is None or known.epoch != call.epoch:
            return None
        changed = replace(known, value=call.value, version=known.version + (known.value != call.value))
        if answer is None:
            return changed
        return self._observe(changed, answer) if isinstance(answer, SeenChannel) else None

    def _delete(self, state: State, channel_id: bytes, answer: object) -> State | None:
        if answer == Refusal("CHANNEL_NOT_FOUND"):
            return self._without(state, channel_id)
        if answer not in (None, DeletedChannel()):
            return None
        known = self._bind(state, channel_id, 0) if isinstance(state, ExistingChannel) else None
        return NoChannel() if known is not None else None

    def _without(self, state: State, channel_id: bytes) -> State | None:
        """The state in which no channel has this id. A channel with an unknown id counts as another channel."""
        return None if isinstance(state, ExistingChannel) and state.channel_id == channel_id else state


def check_channel_histories(operations: Iterable[Operation]) -> int:
    """Check each name's history. Returns the number of names. Raises NotLinearizable or SearchGivenUp."""
    histories = by_key(operations)
    for history in histories.values():
        _check(history)
    return len(histories)


def violations(operations: Iterable[Operation]) -> tuple[int, list[str]]:
    """The number of names, and the errors of the histories that no order explains. Raises nothing."""
    histories = by_key(operations)
    wrong = []
    for history in histories.values():
        try:
            _check(history)
        except (NotLinearizable, SearchGivenUp) as error:
            wrong.append(str(error))
    return len(histories), wrong


def _check(history: list[Operation]) -> None:
    answers = [one.answer for one in history if isinstance(one.answer, SeenChannel) and one.answer.created]
    model = ChannelModel(frozenset(answer.channel_id for answer in answers))
    check_linearizable([one for one in history if not _has_no_outcome(one)], NoChannel(), model.step)


def _has_no_outcome(operation: Operation) -> bool:
    return operation.ambiguous and isinstance(operation.call, Resolve)


def acknowledged_writes(operations: Iterable[Operation]) -> int:
    """The number of acknowledged changes: channels created, values set, channels deleted."""
    return sum(
        isinstance(one.answer, DeletedChannel)
        or (isinstance(one.answer, SeenChannel) and (one.answer.created or isinstance(one.call, Update)))
        for one in operations
    )
