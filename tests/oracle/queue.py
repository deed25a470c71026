"""The oracle's queue: a second implementation that is simple and slow. It looks at every message in every call."""

from __future__ import annotations

from dataclasses import dataclass, field

REMEMBERED = 600 * 10**9
OVERHEAD_BYTES = 64


@dataclass(frozen=True)
class Setup:
    """A queue's limits."""

    max_items: int | None = None
    max_bytes: int = 2**28
    max_item_bytes: int = 2**24
    on_full: str = "block"
    copies: int = 1
    lease: int = 30
    max_deliveries: int | None = None
    dead_letters: bool = False


@dataclass
class Lease:
    id: int
    taker: Taker
    began: int
    ends: int
    number: int


@dataclass
class Message:
    """One message. `returned`: for each copy that came back, the number of its deliveries."""

    seq: int
    length: int
    accepted_at: int
    returned: list[int] = field(default_factory=list)
    leases: list[Lease] = field(default_factory=list)
    done: list[int] = field(default_factory=list)
    held_back_until: int | None = None
    leaving: bool = False
    last: tuple[int, int, str] | None = None


Outcome = tuple[tuple[tuple[int, int], ...], int | None, tuple[tuple[int, str], ...], bool]
"""The accepted positions with their seqs, the time, the refused positions with reasons, and whether the run is a
duplicate.
"""


@dataclass(eq=False)
class Run:
    """A run to enqueue. `left` has the positions without a verdict."""

    lengths: list[int]
    producer_id: int = 0
    first_number: int = 0
    wait: int | None = None
    message_id: str = ""
    left: list[int] = field(default_factory=list)
    first_seq: int | None = None
    stamp: int | None = None
    refused: list[tuple[int, str]] = field(default_factory=list)
    seqs: list[tuple[int, int]] = field(default_factory=list)
    outcome: Outcome | None = None
    gives_up_at: int | None = None
    error: str | None = None


@dataclass(eq=False)
class Taker:
    taker_id: int
    lease: int | None
    credit: int = 0
    last_request_at: int = 0
    silent: bool = False
    busy: bool = False
    unsent: list[int] = field(default_factory=list)


Dealt = tuple[Taker, list[tuple[int, int, int]], int]


class OracleQueue:
    """One queue. Deliveries are added to `dealt`, and finished runs to `finished`; the test takes them from there."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.now = 0
        self.messages: list[Message] = []
        self.next_seq = self.next_delivery = 1
        self.line: list[Run] = []
        self.takers: list[Taker] = []
        self.answered: list[tuple[int, int, int, int, tuple]] = []  # type: ignore[type-arg]
        self.ids: list[tuple[str, int, int]] = []  # message id, seq, time of acceptance
        self.acked: dict[int, tuple[int, int]] = {}
        self.counts = dict.fromkeys(
            ("accepted", "consumed", "dropped", "dead_lettered", "expelled", "delivered", "given_back",
             "leases_expired", "terminated", "duplicates", "rejected_full", "rejected_too_large", "rejected_malformed",
             "rejected_overloaded",
             "accepted_bytes"), 0
        )  # fmt: skip
        self.dealt: list[Dealt] = []
        self.finished: list[Run] = []
        self.dead_letter_seqs: list[int] = []
        self.silent: list[Taker] = []

    # --- calls of producers and takers

    def enqueue(self, run: Run, now: int) -> None:
        self.tick(now)
        run.left = list(range(len(run.lengths)))
        known = self._known(run)
        if known == "overlap":
            raise ValueError("overlap")
        if known is None and (self.line or not self._offer(run)):
            if run.wait is not None and run.wait <= 0:
                self._refuse_rest(run)
            else:
                run.gives_up_at = None if run.wait is None else self.now + run.wait
                self.line.append(run)
        self._deal()

    def withdraw(self, run: Run, now: int) -> None:
        self.tick(now)
        if run in self.line:
            self.line.remove(run)
            self._remember(run)
        self._follow_up()

    def grant(self, taker: Taker, credit: int, now: int) -> None:
        self.tick(now)
        taker.credit += credit
        taker.last_request_at, taker.silent = now, False
        self._wait(taker)

    def _wait(self, taker: Taker) -> None:
        can_wait = taker.credit and not taker.busy and not taker.silent and taker not in self.takers
        if can_wait and not self._serve(taker, 1):
            self.takers.append(taker)

    def sent(self, taker: Taker, now: int) -> None:
        self.tick(now)
        taker.busy, taker.unsent = False, []
        self._wait(taker)

    def drain(self, taker: Taker) -> None:
        taker.credit = 0
        if taker in self.takers:
            self.takers.remove(taker)

    def leave(self, taker: Taker, now: int) -> None:
        self.tick(now)
        self.drain(taker)
        for delivery_id in taker.unsent:
            for message in list(self.messages):
                for lease in [one for one in message.leases if one.id == delivery_id]:
                    message.leases.remove(lease)
                    message.returned += [lease.number - 1] if lease.number > 1 else []
                    self.counts["delivered"] -= 1
                    self._leave_if_exhausted(message)
        taker.unsent = []
        self._follow_up()

    def settle(self, taker_id: int, verdicts: list[tuple[str, int, int]], now: int) -> list[str | None]:
        """Settle deliveries.

        A verdict is (kind, delivery id, delay in nanoseconds). Returns the refusal of each; None: settled.
        """
        self.tick(now)
        answers = [self._settle(taker_id, *verdict) for verdict in verdicts]
        self._follow_up()
        return answers

    def _settle(self, taker_id: int, kind: str, delivery_id: int, nanos: int) -> str | None:
        if kind == "ack":
            return self._acknowledge(taker_id, delivery_id)
        if kind == "term":
            return self._terminate(taker_id, delivery_id)
        if kind in ("nack", "uncounted"):
            return self._give_back(taker_id, delivery_id, nanos, counted=kind == "nack")
        return self._extend(taker_id, delivery_id, nanos)

    def _acknowledge(self, taker_id: int, delivery_id: int) -> str | None:
        found = self._leased(taker_id, delivery_id)
        if found is None:
            by, when = self.acked.get(delivery_id, (0, 0))
            return None if by == taker_id and when > self.now - REMEMBERED else "LEASE_EXPIRED"
        message, lease = found
        message.leases.remove(lease)
        message.done.append(taker_id)
        self.acked[delivery_id] = (taker_id, self.now)
        self._use_up(message)
        return None

    def _give_back(self, taker_id: int, delivery_id: int, delay: int, *, counted: bool) -> str | None:
        found = self._leased(taker_id, delivery_id)
        if found is None:
            return "LEASE_EXPIRED"
        found[1].number -= not counted
        self.counts["given_back"] += 1
        self._in_vain(*found, "given_back" if counted else "", delay)
        return None

    def _terminate(self, taker_id: int, delivery_id: int) -> str | None:
        found = self._leased(taker_id, delivery_id)
        if found is None:
            return "LEASE_EXPIRED"
        message, lease = found
        self.counts["terminated"] += 1
        message.last = (lease.number, taker_id, "terminated")
        self._give_up(message)
        return None

    def _extend(self, taker_id: int, delivery_id: int, lease: int) -> str | None:
        found = self._leased(taker_id, delivery_id)
        if found is None:
            return "LEASE_EXPIRED"
        found[1].ends = self.now + lease
        return None

    def dead_letter_moved(self, seq: int, now: int) -> None:
        self.tick(now)
        if seq in self.dead_letter_seqs:
            self.dead_letter_seqs.remove(seq)
            self.messages = [message for message in self.messages if message.seq != seq]
            self.counts["dead_lettered"] += 1
            self._follow_up()

    def configure(self, setup: Setup, now: int) -> None:
        self.tick(now)
        self.setup = setup
        for message in list(self.messages):
            if message.leaving and not setup.dead_letters:
                self.dead_letter_seqs.remove(message.seq)
                self._expel(message)
            elif not self._use_up(message):
                self._leave_if_exhausted(message)
        self._follow_up()

    def tick(self, now: int) -> None:
        self.now = now
        self.ids = [known for known in self.ids if known[2] > now - REMEMBERED]
        ended = [(lease.ends, lease.id) for message in self.messages for lease in message.leases if lease.ends <= now]
        for _, delivery_id in sorted(ended):
            for message in list(self.messages):
                for lease in [one for one in message.leases if one.id == delivery_id]:
                    self.counts["leases_expired"] += 1
                    self._fall_silent(lease)
                    self._in_vain(message, lease, "lease_expired", 0)
        released = [
            message
            for message in self.messages
            if message.held_back_until is not None and message.held_back_until <= now
        ]
        for message in released:
            message.held_back_until = None
        over = [run for run in self.line if run.gives_up_at is not None and run.gives_up_at <= now]
        for run in sorted(over, key=lambda one: (one.gives_up_at or 0, self.line.index(one))):
            self.line.remove(run)
            self._refuse_rest(run)
            self.finished.append(run)
        if ended or released or over:
            self._follow_up()

    def _fall_silent(self, lease: Lease) -> None:
        taker = lease.taker
        if taker.credit and not taker.silent and taker.last_request_at <= lease.began:
            taker.silent = True
            self.silent.append(taker)
            if taker in self.takers:
                self.takers.remove(taker)

    # --- effects of calls and of time

    def pending(self) -> list[tuple[int, int, int, int, int, int]]:
        found = [
            (lease.id, message.seq, lease.taker.taker_id, lease.number, lease.began, lease.ends)
            for message in self.messages
            for lease in message.leases
        ]
        return sorted(found)

    def next_deadline(self) -> int | None:
        due = [lease.ends for message in self.messages for lease in message.leases]
        due += [message.held_back_until for message in self.messages if message.held_back_until is not None]
        due += [when + REMEMBERED for _, _, when in self.ids]
        due += [run.gives_up_at for run in self.line if run.gives_up_at is not None]
        return min(due, default=None)

    def counters(self) -> dict[str, int]:
        return {
            **self.counts,
            "held": len(self.messages),
            "leased": sum(bool(message.leases) for message in self.messages),
            "held_bytes": sum(message.length for message in self.messages),
        }

    def _follow_up(self) -> None:
        while self.line:
            run = self.line[0]
            known = self._known(run)
            if known == "overlap":
                run.error = "INVALID_ARGUMENT"
            elif known is None and not self._offer(run):
                break
            self.finished.append(self.line.pop(0))
        self._deal()

    def _known(self, run: Run) -> str | None:
        """Whether the queue knows the run:

        "known", "overlap" with another run, or None. Resumes a run that is known in part.
        """
        first, end = run.first_number, run.first_number + len(run.lengths)
        for producer_id, begin, stop, when, judged in reversed(self.answered):
            if not run.producer_id or producer_id != run.producer_id or when <= self.now - REMEMBERED:
                continue
            if (begin, stop) == (first, end):
                first_seq, stamp, seqs, refused, left = judged
                if len(left) < len(run.left):
                    run.first_seq, run.stamp, run.left = first_seq, stamp, list(left)
                    run.seqs, run.refused = list(seqs), list(refused)
                run.outcome = None if left else (tuple(seqs), stamp, tuple(refused), False)
                return None if left else "known"
            if begin < end and first < stop:
                return "overlap"
        for message_id, seq, _ in self.ids:
            if message_id == run.message_id:
                self.counts["duplicates"] += 1
                run.outcome = (((0, seq),), None, (), True)
                return "known"
        return None

    def _offer(self, run: Run) -> bool:
        setup, known_seqs = self.setup, len(run.seqs)
        while run.left:
            place = run.left[0]
            length = run.lengths[place]
            if length > setup.max_item_bytes or length + OVERHEAD_BYTES > setup.max_bytes:
                self._refuse(run, "ITEM_TOO_LARGE")
                continue
            while setup.on_full == "drop_oldest" and not self._has_room(length):
                free = [message for message in self.messages if not message.leases and not message.leaving]
                if not free:
                    break
                self.messages.remove(free[0])
                self.counts["dropped"] += 1
            if self._has_room(length):
                self._accept(run, length)
            elif setup.on_full == "block":
                if len(run.seqs) > known_seqs:
                    self._remember(run)
                return False
            else:
                self._refuse(run, "QUEUE_FULL")
        self._answer(run)
        return True

    def _has_room(self, length: int) -> bool:
        charged = sum(message.length + OVERHEAD_BYTES for message in self.messages) + length + OVERHEAD_BYTES
        if self.setup.max_items is not None and len(self.messages) >= self.setup.max_items:
            return False
        return charged <= self.setup.max_bytes

    def _accept(self, run: Run, length: int) -> None:
        if run.first_seq is None:
            run.first_seq, run.stamp = self.next_seq, self.now
        run.seqs.append((run.left[0], self.next_seq))
        self.messages.append(Message(self.next_seq, length, self.now))
        self.next_seq += 1
        self.counts["accepted"] += 1
        self.counts["accepted_bytes"] += length
        run.left.pop(0)

    def _refuse(self, run: Run, why: str) -> None:
        self.counts["rejected_full" if why == "QUEUE_FULL" else "rejected_too_large"] += 1
        run.refused.append((run.left.pop(0), why))

    def _refuse_rest(self, run: Run) -> None:
        while run.left:
            self._refuse(run, "QUEUE_FULL")
        self._answer(run)

    def _answer(self, run: Run) -> None:
        if run.message_id and run.first_seq is not None:
            self.ids.append((run.message_id, run.first_seq, self.now))
        run.outcome = (tuple(run.seqs), run.stamp, tuple(run.refused), False)
        self._remember(run)

    def _remember(self, run: Run) -> None:
        """Keep the outcome of the run. Without an accepted message, a repeated run is judged anew."""
        if run.first_seq is not None:
            end = run.first_number + len(run.lengths)
            judged = (run.first_seq, run.stamp, tuple(run.seqs), tuple(run.refused), tuple(run.left))
            self.answered.append((run.producer_id, run.first_number, end, self.now, judged))

    def _leased(self, taker_id: int, delivery_id: int) -> tuple[Message, Lease] | None:
        for message in self.messages:
            for lease in message.leases:
                if lease.id == delivery_id and lease.taker.taker_id == taker_id:
                    lease.taker.last_request_at = self.now
                    return message, lease
        return None

    def _in_vain(self, message: Message, lease: Lease, how: str, delay: int) -> None:
        message.leases.remove(lease)
        message.returned += [lease.number] if lease.number else []
        if how:
            message.last = (lease.number, lease.taker.taker_id, how)
        if not self._leave_if_exhausted(message) and delay:
            message.held_back_until = max(self.now + delay, message.held_back_until or 0)

    def _leave_if_exhausted(self, message: Message) -> bool:
        most = self.setup.max_deliveries
        exhausted = most is not None and max(message.returned, default=0) >= most
        if exhausted and not message.leaving:
            self._give_up(message)
        return exhausted

    def _give_up(self, message: Message) -> None:
        message.leases.clear()
        if self.setup.dead_letters:
            message.leaving, message.held_back_until = True, None
            self.dead_letter_seqs.append(message.seq)
        else:
            self._expel(message)

    def _expel(self, message: Message) -> None:
        self.messages.remove(message)
        self.counts["expelled"] += 1

    def _use_up(self, message: Message) -> bool:
        enough = len(message.done) >= self.setup.copies
        if enough:
            self.messages.remove(message)
            self.counts["consumed"] += 1
            if message.leaving:
                self.dead_letter_seqs.remove(message.seq)
        return enough

    def _free(self, message: Message) -> bool:
        copies = self.setup.copies - len(message.leases) - len(message.done)
        return copies > 0 and message.held_back_until is None and not message.leaving

    def _deal(self) -> None:
        line = list(self.takers)
        for place, taker in enumerate(line):
            if self._serve(taker, len(line) - place):
                self.takers.remove(taker)

    def _serve(self, taker: Taker, takers: int) -> bool:
        """Deliver to one taker its equal share of the available messages, the oldest first. Leave out messages that the
        taker had before.
        """
        free = [message for message in self.messages if self._free(message)]
        share = min(-(-len(free) * self.setup.copies // takers), taker.credit)
        mine = [
            message
            for message in free
            if taker.taker_id not in message.done
            and all(lease.taker.taker_id != taker.taker_id for lease in message.leases)
        ]
        ends = self.now + (taker.lease or self.setup.lease)
        given = [self._lease(message, taker, ends) for message in mine[:share]]
        if not given:
            return False
        taker.credit -= len(given)
        taker.busy, taker.unsent = True, [delivery_id for _, delivery_id, _ in given]
        self.dealt.append((taker, given, ends))
        return True

    def _lease(self, message: Message, taker: Taker, ends: int) -> tuple[int, int, int]:
        before = max(message.returned, default=0)
        if before:
            message.returned.remove(before)
        message.leases.append(Lease(self.next_delivery, taker, self.now, ends, before + 1))
        self.next_delivery += 1
        self.counts["delivered"] += 1
        return message.seq, self.next_delivery - 1, before + 1
