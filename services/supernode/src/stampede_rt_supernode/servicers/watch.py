"""Serves watches. A watch is a position in the ring of recent changes, and has no buffer of its own.

So a slow watcher costs no memory. If the ring drops changes that the watcher has not read, the watch ends with
WATCH_RESTART, and the watcher lists again.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice

from stampede_rt.errors import Unavailable, WatchRestart
from stampede_rt_runtime.access.control import current_work
from stampede_rt_supernode.core.change_ring import ChangePage, ChangeRing
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.glob import matcher
from stampede_rt_supernode.core.records import (
    AccessChange,
    ChannelRecord,
    DirectoryChange,
    GroupRecord,
    HostRecord,
    PeerRecord,
    QueueRecord,
)
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReplicatedLog

logger = logging.getLogger(__name__)

CHANGES_PER_RESPONSE_MAX = 64
"""The most changes that one watch looks at in one turn of the event loop."""
WATCHES_PER_TURN = 8
"""The most watches that are woken in one turn of the event loop."""
SIGN_OF_LIFE_SECONDS = 5.0

IsShown = Callable[[DirectoryChange], bool]


@dataclass(frozen=True, slots=True)
class WatchBatch:
    """Changes in order, perhaps none. The watch has returned all its changes up to log position `applied_index`."""

    changes: tuple[DirectoryChange, ...]
    applied_index: int


class Watches:
    """The watches of one supernode, on one event loop. `close` ends them all."""

    def __init__(
        self, replica: DirectoryReplica, log: ReplicatedLog, *, sign_of_life_seconds: float = SIGN_OF_LIFE_SECONDS
    ) -> None:
        self._replica = replica
        self._log = log
        self._sign_of_life_seconds = sign_of_life_seconds
        self._notifier = _Notifier()
        self._closed = False
        replica.listen(self._notifier.notify)

    def close(self) -> None:
        """End every present and later watch with SHUTTING_DOWN."""
        self._closed = True
        self._notifier.wake()

    def follow(
        self,
        glob: str,
        after_index: int,
        *,
        include_hosts: bool,
        include_groups: bool = False,
        include_queues: bool = False,
        include_access: bool = False,
        is_shown: IsShown = lambda change: True,
    ) -> AsyncIterator[WatchBatch]:
        """The changes of channels, and of other things as requested; see `_follow`.

        A change for which `is_shown` is false makes no batch, because an empty batch would show that there was a
        change.
        """
        wanted = _filter(glob, include_hosts, include_groups, include_queues, include_access)
        return self._follow(
            lambda directory: directory.tables.changes, lambda one: wanted(one) and is_shown(one), after_index
        )

    def follow_peers(
        self, glob: str, after_index: int, *, is_shown: IsShown = lambda change: True
    ) -> AsyncIterator[WatchBatch]:
        """The changes of peers; with an empty `glob` also of peers without a name; see `follow` and `_follow`."""
        wanted = _peer_filter(glob)
        return self._follow(
            lambda directory: directory.tables.peers.changes, lambda one: wanted(one) and is_shown(one), after_index
        )

    async def _follow(
        self, ring_of: Callable[[Directory], ChangeRing], wanted: Callable[[DirectoryChange], bool], after_index: int
    ) -> AsyncIterator[WatchBatch]:
        """Batches without end. The first batch is empty and says where the watch begins. Signs of life are empty, too.

        `after_index`: the log position after which the watch begins; 0 for the present position. The caller must
        confirm a read just before the call. Raises WatchRestart if the ring lacks changes for this watch. Raises
        Unavailable when this supernode stops or knows no leader. `follow` raises InvalidArgument for an invalid
        pattern.
        """
        position, index, restored = self._replica.read(lambda directory: self._begin(directory, ring_of, after_index))
        yield WatchBatch((), index)
        alive, work = _SignOfLife(self._sign_of_life_seconds), current_work()
        with self._notifier.listening() as event:
            while True:
                if work.must_wait:
                    await work.turn()
                event.clear()  # before the read of the ring, so that the event announces every change after that read
                page = self._replica.read(lambda directory, p=position: self._page(ring_of(directory), p, restored))  # type: ignore[misc]
                position = page.position
                changes = tuple(change for change in page.changes if wanted(change))
                if not page.changes:
                    self._check_open()
                if changes or alive.is_due:
                    if not changes:
                        self._check_leader()
                    yield WatchBatch(changes, page.index)
                    alive.note_sent()
                if page.changes:
                    await asyncio.sleep(0)  # there may be more changes already
                else:
                    await _wait_for(event, alive.seconds_left)

    def _begin(
        self, directory: Directory, ring_of: Callable[[Directory], ChangeRing], after_index: int
    ) -> tuple[int, int, int]:
        ring, index = ring_of(directory), after_index or directory.applied_index
        position = ring.position_after(index) if index <= directory.applied_index else None
        if position is None:
            raise _restart(f"the changes after index {after_index} are not kept here")
        return position, index, self._replica.restored

    def _page(self, ring: ChangeRing, position: int, restored: int) -> ChangePage:
        page = ring.read(position, CHANGES_PER_RESPONSE_MAX)
        if page is None or restored != self._replica.restored:
            raise _restart("the watch fell behind the changes that are kept")
        return page

    def _check_open(self) -> None:
        if self._closed:
            raise Unavailable("this supernode is about to stop; watch at another supernode", reason="SHUTTING_DOWN")

    def _check_leader(self) -> None:
        if self._log.status().leader_id is None:
            text = "this supernode knows no leader, so it gets no changes; watch at another supernode"
            raise Unavailable(text, reason="NO_QUORUM")


def _restart(reason: str) -> WatchRestart:
    return WatchRestart(f"{reason}; list again, then watch from that answer's index")


def _filter(
    glob: str, include_hosts: bool, include_groups: bool, include_queues: bool, include_access: bool
) -> Callable[[DirectoryChange], bool]:
    matches = matcher(glob)

    def wanted(change: DirectoryChange) -> bool:
        match change.subject:
            case HostRecord():
                return include_hosts
            case ChannelRecord(name=name):
                return matches(name)
            case GroupRecord(name=name):
                return include_groups and matches(name)
            case QueueRecord(name=name):
                return include_queues and _matches(name, glob, matches)
            case AccessChange():
                return include_access
            case PeerRecord():
                return False  # changes of peers are in a ring of their own

    return wanted


def _peer_filter(glob: str) -> Callable[[DirectoryChange], bool]:
    matches = matcher(glob)

    def wanted(change: DirectoryChange) -> bool:
        assert isinstance(change.subject, PeerRecord)  # the ring of peers holds nothing else
        return _matches(change.subject.name, glob, matches)

    return wanted


def _matches(name: str, glob: str, matches: Callable[[str], bool]) -> bool:
    """Whether the name matches the pattern. A mailbox or peer without a name matches only an empty pattern."""
    return matches(name) if name else not glob


async def _wait_for(event: asyncio.Event, seconds: float) -> None:
    """Wait for the event, for at most `seconds`."""
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await event.wait()


class _SignOfLife:
    """The time at which a stream must send a sign of life: `every_seconds` after its last message.

    A wake-up of the watch without a message does not move this time. Every commit wakes the watch, also a commit
    without a watched change.
    """

    def __init__(self, every_seconds: float) -> None:
        self._every_seconds = every_seconds
        self.note_sent()

    def note_sent(self) -> None:
        """Note that the stream sends a message now."""
        self._due_s = asyncio.get_running_loop().time() + self._every_seconds

    @property
    def seconds_left(self) -> float:
        """The seconds until the sign of life is due; 0 or less if it is due now."""
        return self._due_s - asyncio.get_running_loop().time()

    @property
    def is_due(self) -> bool:
        """Whether the stream must send a sign of life now."""
        return self.seconds_left <= 0


class _Notifier:
    """Wakes all waiting coroutines on the event loop, WATCHES_PER_TURN of them in each turn.

    Any thread may call `notify`. Several calls before the wake-up count as one. If `notify` is called again during a
    wake-up, the coroutines that still wait for it keep their order.
    """

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._listening: dict[asyncio.Event, None] = {}
        self._to_wake: dict[asyncio.Event, None] = {}
        self._is_notified = False

    @contextmanager
    def listening(self) -> Iterator[asyncio.Event]:
        """An event that is set after each call of `notify`, for as long as the context lasts."""
        event = asyncio.Event()
        self._listening[event] = None
        try:
            yield event
        finally:
            del self._listening[event]
            self._to_wake.pop(event, None)

    def notify(self) -> None:
        """Wake all waiting coroutines soon. Any thread may call this. Does nothing after the loop has closed."""
        if self._is_notified:
            return
        self._is_notified = True
        try:
            self._loop.call_soon_threadsafe(self.wake)
        except RuntimeError:
            logger.debug("a change came after the event loop had closed", extra={"event": "change_after_end"})

    def wake(self) -> None:
        """Begin to wake the coroutines that wait. Call it on the loop."""
        self._is_notified = False
        is_waking = bool(self._to_wake)
        self._to_wake.update(self._listening)
        if not is_waking:
            self._wake_some()

    def _wake_some(self) -> None:
        for event in [*islice(self._to_wake, WATCHES_PER_TURN)]:
            del self._to_wake[event]
            event.set()
        if self._to_wake:
            self._loop.call_soon(self._wake_some)
