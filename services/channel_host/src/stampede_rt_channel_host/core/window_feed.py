"""The feed of a retry window: its records, for the window of a copy. Pure."""

from __future__ import annotations

from itertools import islice

from stampede_rt_channel_host.core.dedup import KeptRun, KnownProducer, RetryWindow


class WindowFeed:
    """Takes from a window its records since the last take, so that another window can follow it.

    `since`: the other window has all records before this time of the host's clock; None: it has none.
    """

    def __init__(self, window: RetryWindow, since: int | None) -> None:
        self._window = window
        self._since = -(2**63) if since is None else since
        self._recorded = -1  # the number of the window's records at the last take that returned all
        self._left_at = self._since  # the time of the latest record of that take
        self._sent: dict[int, tuple[KnownProducer, int]] = {}  # by producer id: its records as of the last take

    @property
    def is_caught_up(self) -> bool:
        """Whether the takes have returned all records."""
        return self._recorded == self._window.recorded

    def take(self, runs_max: int) -> list[KeptRun]:
        """The next runs, the earliest first: about `runs_max`, or all runs of one producer."""
        if self.is_caught_up:
            return []
        found: list[KeptRun] = []
        for producer_id, producer in self._changed():
            if len(found) >= runs_max:
                return found
            found += self._of(producer_id, producer)
        self._recorded = self._window.recorded
        latest = self._window.latest_time
        self._left_at = self._left_at if latest is None else latest
        if len(self._sent) > len(self._window.producers):  # the window has forgotten some
            self._sent = {at: one for at, one in self._sent.items() if self._window.producers.get(at) is one[0]}
        return found

    def take_put(self) -> KeptRun | None:
        """The run of the only new record, if it continues the runs of its producer and all its items were accepted.

        None for anything else: call `take`.
        """
        window = self._window
        if window.recorded != self._recorded + 1 or not window.producers:  # forgotten already
            return None
        producer_id, producer = next(reversed(window.producers.items()))
        if self._sent.get(producer_id) != (producer, producer.recorded - 1):
            return None
        first_number, outcome = next(producer.runs())
        if len(outcome.parts) != 1 or outcome.parts[0].items != outcome.items:
            return None
        self._sent[producer_id] = producer, producer.recorded
        self._recorded, self._left_at = window.recorded, outcome.time
        return KeptRun(producer_id, first_number, outcome, producer.caller_name)

    def pass_put(self, producer_id: int, caller_name: str, time: int) -> bool:
        """Note that the other window gets the next record of this window, made at `time`, in another way.

        Returns False, and notes nothing, if the other window lacks earlier records, or does not know the producer.
        """
        producer = self._window.producers.get(producer_id)
        is_known = producer is not None and self._sent.get(producer_id) == (producer, producer.recorded)
        if producer is None or not is_known or not self.is_caught_up or producer.caller_name != caller_name:
            return False
        self._sent[producer_id] = producer, producer.recorded + 1
        self._recorded, self._left_at = self._recorded + 1, time
        return True

    def _changed(self) -> list[tuple[int, KnownProducer]]:
        """The producers with new records, the longest silent one first."""
        changed = []
        for producer_id, producer in reversed(self._window.producers.items()):
            if producer.latest < self._left_at:
                break
            sent = self._sent.get(producer_id)
            if sent is None or sent != (producer, producer.recorded):
                changed.append((producer_id, producer))
        return changed[::-1]

    def _of(self, producer_id: int, producer: KnownProducer) -> list[KeptRun]:
        former, count = self._sent.get(producer_id, (None, 0))
        new = producer.recorded - (count if former is producer else 0)
        self._sent[producer_id] = producer, producer.recorded
        latest = dict(reversed([*islice(producer.runs(), new)]))
        return [
            KeptRun(producer_id, first_number, outcome, producer.caller_name)
            for first_number, outcome in latest.items()
            if outcome.time >= self._since
        ]
