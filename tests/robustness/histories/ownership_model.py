"""The model of one channel's items: a sequential object with one owner at a time.

An owner takes items under one *incarnation*, with seqs that grow. After an answer of a later incarnation, an earlier
incarnation may not accept items: two incarnations that both accept are two owners.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tests.robustness.histories.linearizability import NotLinearizable, SearchGivenUp, check_linearizable
from tests.robustness.histories.operations import Operation, by_key

LAG_SECONDS_MAX = 1.0  # the greatest lag of a replica in sync
SLACK_SECONDS = 1.0  # the greatest delay of an answer


@dataclass(frozen=True, slots=True)
class Put:
    """A put of an item with a payload that no other put has."""

    payload: bytes


@dataclass(frozen=True, slots=True)
class Newest:
    """A read of the newest item."""


@dataclass(frozen=True, slots=True)
class ReadAll:
    """A read of all items. Retention collects none during a history."""


@dataclass(frozen=True, slots=True)
class ItemStored:
    """The host has stored the item."""

    incarnation: int
    seq: int


@dataclass(frozen=True, slots=True)
class NewestSeq:
    """The newest item's seq; 0 if there was none."""

    incarnation: int
    seq: int


@dataclass(frozen=True, slots=True)
class AllItems:
    """All items: (seq, payload)."""

    incarnation: int
    items: tuple[tuple[int, bytes], ...]


@dataclass(frozen=True, slots=True)
class OwnerState:
    """The owner's incarnation, the newest known seq, and the incarnations that are over."""

    incarnation: int = 0
    seq: int = 0
    past: frozenset[int] = frozenset()

    def under(self, incarnation: int) -> OwnerState | None:
        """The state after an answer of `incarnation`; None if that incarnation is over."""
        if incarnation == self.incarnation:
            return self
        return None if incarnation in self.past else OwnerState(incarnation, 0, self.past | {self.incarnation})


def step(state: OwnerState, operation: Operation) -> OwnerState | None:
    """The state after `operation`; None if the operation cannot give this answer in `state`."""
    answer = operation.answer
    if isinstance(answer, ItemStored):
        owned = state.under(answer.incarnation)
        fits = owned is not None and answer.seq > owned.seq
        return OwnerState(owned.incarnation, answer.seq, owned.past) if owned is not None and fits else None
    if isinstance(answer, NewestSeq | AllItems):
        owned = state.under(answer.incarnation)
        newest = answer.seq if isinstance(answer, NewestSeq) else max((seq for seq, _ in answer.items), default=0)
        # The seq is higher than the known one: other puts whose answers are unknown came before.
        fits = owned is not None and newest >= owned.seq
        return OwnerState(owned.incarnation, newest, owned.past) if owned is not None and fits else None
    raise AssertionError(f"no such answer: {answer}")


@dataclass(frozen=True, slots=True)
class Judgement:
    """The judgement of the histories.

    `lost`: items that were acknowledged, or that a reader saw, but that a later reader of the same incarnation did not
    see. `doubled`: items that a reader saw twice. `gone_with_host`: items that were acknowledged or seen under an
    incarnation which has ended; without replicas the promise allows this loss, and the new incarnation informs the
    readers. `violations` describes everything that the model does not allow: lost and doubled items, items that no
    caller put, two owners, and stale reads.
    """

    channels: int
    acknowledged: int
    lost: int
    doubled: int
    gone_with_host: int
    violations: tuple[str, ...]


def judge_items(operations: Iterable[Operation]) -> Judgement:
    """Check each channel's history. Raises nothing: the result has all violations."""
    histories = by_key(operations)
    lost = doubled = gone = acknowledged = 0
    violations: list[str] = []
    for name, history in histories.items():
        missing, twice, strange = _shown_wrong(history)
        lost, doubled = lost + len(missing), doubled + len(twice)
        violations += [f"{name}: {payload!r} was acknowledged or seen, and is lost" for payload in sorted(missing)]
        violations += [f"{name}: {payload!r} was stored twice" for payload in sorted(twice)]
        violations += [f"{name}: no caller put {payload!r}" for payload in sorted(strange)]
        try:
            check_linearizable([one for one in history if not one.ambiguous], OwnerState(), step)
        except (NotLinearizable, SearchGivenUp) as error:
            violations.append(str(error))
        acknowledged += sum(isinstance(one.answer, ItemStored) for one in history)
        gone += sum(len(lost) for _, _, lost in _lost_with_hosts(history))
    return Judgement(len(histories), acknowledged, lost, doubled, gone, tuple(violations))


def _known(history: Sequence[Operation]) -> dict[int, dict[tuple[int, bytes], float]]:
    """The time at which each (seq, payload) of each incarnation became known: by the ack of its put, or by a reader.

    The incarnations are in the order in which their first items became known.
    """
    found: dict[int, dict[tuple[int, bytes], float]] = defaultdict(dict)
    for one in sorted(history, key=lambda one: one.returned):
        if isinstance(one.answer, ItemStored):
            found[one.answer.incarnation].setdefault((one.answer.seq, one.call.payload), one.returned)
        elif isinstance(one.answer, AllItems):
            for item in one.answer.items:
                found[one.answer.incarnation].setdefault(item, one.returned)
    return found


def _lost_with_hosts(history: Sequence[Operation]) -> list[tuple[int, int, dict[tuple[int, bytes], float]]]:
    """Each incarnation that has ended, the next one, and the known items that no reader has got again later."""
    known = [*_known(history).items()]
    found = []
    for at, (incarnation, items) in enumerate(known[:-1]):
        later_items = {item for _, later in known[at + 1 :] for item in later}
        found.append(
            (incarnation, known[at + 1][0], {item: since for item, since in items.items() if item not in later_items})
        )
    return found


def early_losses(operations: Iterable[Operation], slack_s: float = SLACK_SECONDS) -> list[str]:
    """Describe the items that a replica lacked when it became the owner, although it should have had them by then.

    These items were known long before the last acknowledgement of the former incarnation. If the number of the next
    incarnation is one higher, a replica has become the owner. An incarnation counts only if a reader has read all of
    its items. Otherwise it is unknown which items are lost.
    """
    found: list[str] = []
    for name, history in by_key(operations).items():
        read = {one.answer.incarnation for one in history if isinstance(one.answer, AllItems)}
        for incarnation, after, lost in _lost_with_hosts(history):
            last = _last_acknowledgement(history, incarnation)  # not of reads: they may show unacknowledged items
            early = [item for item, since in lost.items() if since < last - LAG_SECONDS_MAX - slack_s]
            if early and after in read and after == (incarnation + 1) % 2**64:
                found.append(
                    f"{name}: {len(early)} items were lost that were known more than {LAG_SECONDS_MAX:g} s before the "
                    "last acknowledgement"
                )
    return found


def _last_acknowledgement(history: Sequence[Operation], incarnation: int) -> float:
    answers = ((one.returned, one.answer) for one in history)
    times = (at for at, one in answers if isinstance(one, ItemStored) and one.incarnation == incarnation)
    return max(times, default=0.0)


def _shown_wrong(history: Sequence[Operation]) -> tuple[set[bytes], set[bytes], set[bytes]]:
    """The payloads that complete reads show as lost, as doubled, and as never put."""
    known = _known(history)
    put = {one.call.payload for one in history if isinstance(one.call, Put)}
    lost: set[bytes] = set()
    doubled: set[bytes] = set()
    strange: set[bytes] = set()
    for reading in history:
        if not isinstance(reading.answer, AllItems):
            continue
        payloads = [payload for _, payload in reading.answer.items]
        before = {item for item, since in known[reading.answer.incarnation].items() if since < reading.invoked}
        lost |= {payload for _, payload in before - set(reading.answer.items)}
        doubled |= {payload for payload, times in Counter(payloads).items() if times > 1}
        strange |= set(payloads) - put
    return lost, doubled, strange
