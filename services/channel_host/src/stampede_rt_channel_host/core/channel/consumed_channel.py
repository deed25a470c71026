"""The consumption of the items of one channel, over values and `now` (paper, section 3.4). Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from stampede_rt.errors import InvalidArgument
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.base_channel import BaseChannel
from stampede_rt_channel_host.core.channel.consumer_places import LEASE_NANOS, ConsumerPlace, ConsumerStanding
from stampede_rt_channel_host.core.channel.consumption import ConsumptionResult, check_consumption
from stampede_rt_channel_host.core.channel.pieces import Pieces, run_to_end
from stampede_rt_channel_host.core.channel.values import Counters


class ConsumedChannel(BaseChannel):
    """A channel whose consumers report which items they have consumed. See `ChannelCore` for `now`."""

    def consume(
        self, consumer_id: int, seqs: Sequence[int], now: int, *, lease_nanos: int = LEASE_NANOS, caller_name: str = ""
    ) -> ConsumptionResult:
        """Consume items for one consumer, and collect the items that all consumers have consumed. Safe to repeat.

        Takes a place for the consumer if it has none, and keeps the place for `lease_nanos` from now (see the module
        `consumption`). A lease of 0 gives the place up. `seqs` may be empty. If `caller_name` is
        empty, the number of the caller's places has no limit.

        Raises InvalidArgument (see `check_consumption`), ChannelFull if all places are taken, and Overloaded if the
        caller has as many places as one caller may have.
        """
        run_to_end(self.catching_up(now))
        clock = self._age_and_free(self._tick(now))
        self.check_consumption(consumer_id, seqs, lease_nanos)
        consumers = self._retention.consumers
        assert consumers is not None, "it is checked"
        newest_seq = self._held.newest_seq
        consumed = consumers.consume(
            consumer_id,
            seqs,
            next_seq=self.next_seq,
            newest_seq=newest_seq,
            clock=clock,
            lease=lease_nanos,
            caller_name=caller_name,
        )
        self._age_and_free(clock)
        return consumed

    def consumption_bytes_of(self, caller_name: str) -> int:
        """The memory of the consumer places of one caller, in bytes."""
        consumers = self._retention.consumers
        return 0 if consumers is None else consumers.table.footprint_bytes_of(caller_name)

    def consumption_bytes(self, consumer_id: int, seqs: Sequence[int]) -> int:
        """The most memory that `consume` adds for these seqs. Call `check_consumption` first."""
        consumers = self._retention.consumers
        return 0 if consumers is None else consumers.wanted_bytes(consumer_id, seqs)

    def check_consumption(self, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> None:
        """Raises InvalidArgument if the channel has no consumers, or if an argument is out of its range."""
        if self._retention.consumers is None:
            raise InvalidArgument(
                "the channel counts no consumption: it was created without consumers; create it with consumers=, or "
                "add them with configure()"
            )
        check_consumption(consumer_id, seqs, self.next_seq, lease_nanos)

    def catching_up(self, now: int) -> Pieces[None]:
        """Tell the consumer places which items retention has collected, in pieces.

        Perform these pieces before `consume`, `consumer_places` and `restore_consumers`. Otherwise these methods do all
        this work in one step.
        """
        self._age_and_free(self._tick(now))
        while self._retention.report_collected(pieces.STEPS_PER_PIECE // 4):  # a report takes longer than a look
            yield

    def consumers(self, now: int) -> list[ConsumerStanding]:
        """The state of each place that was taken."""
        return run_to_end(self.counting_consumers(now))

    def counting_consumers(self, now: int) -> Pieces[list[ConsumerStanding]]:
        """Like `consumers`, but in pieces. A consumer's waiting items are counted at different moments."""
        yield from self.catching_up(now)
        clock = self._age_and_free(self._tick(now))
        consumers = self._retention.consumers
        return [] if consumers is None else (yield from consumers.standings(clock, self.next_seq))

    def consumer_places(self, now: int) -> list[ConsumerPlace]:
        """The taken places as values, which can move with the channel to another owner."""
        run_to_end(self.catching_up(now))
        clock = self._age_and_free(self._tick(now))
        consumers = self._retention.consumers
        return [] if consumers is None else consumers.places(clock, self.next_seq)

    def inherit(
        self, clock: int, advance: int | None, counters: Counters | None, places: Iterable[ConsumerPlace]
    ) -> None:
        """Take over the facts of another owner, before any other call. `clock`: the host's clock.

        Applies no limit before the places are known, because consumers keep items beyond max_age.
        """
        self._tick(clock)
        self._acceptance.advance = self._reading.advance = advance
        self._reading.consumed_up_to = self._held.newest_consumed
        if counters is not None:
            self._held.inherit_counts(counters)
            self._acceptance.inherit_rejected(counters.rejected)
        consumers = self._retention.consumers
        if consumers is not None:
            while self._retention.report_collected(pieces.STEPS_PER_PIECE):
                pass
            consumers.restore(places, clock)

    def restore_consumers(self, places: Iterable[ConsumerPlace], now: int) -> None:
        """Take over the places that `consumer_places` gave at another host.

        Does nothing if the policy has no consumers.
        """
        run_to_end(self.catching_up(now))
        clock = self._age_and_free(self._tick(now))
        if self._retention.consumers is not None:
            self._retention.consumers.restore(places, clock)
            self._age_and_free(clock)
