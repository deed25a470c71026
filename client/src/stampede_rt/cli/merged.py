"""`stampede sub`: the items of all channels that match a glob, as one stream in the order of their times."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import (
    add_verb,
    checked,
    connected,
    parse_bound_text,
    parse_count,
    timeout_seconds,
)
from stampede_rt.cli.interrupts import interruption
from stampede_rt.cli.item_text import add_item_options, item_printer, print_dropped
from stampede_rt.cli.merging import MergedItem, TimeMerge
from stampede_rt.errors import ChannelNotFound, IncarnationLost, StampedeError, WatchRestart
from stampede_rt.escaping import escaped
from stampede_rt.values.model import ChannelInfo, Item
from stampede_rt.values.timeline import OLDEST, Bound

if TYPE_CHECKING:
    from stampede_rt import Connection

CHANNELS_MAX = 128
"""The most channels of one stream. Each has a thread, and at most 64 items or 256 KiB, or one larger item, waiting."""
LOOK_S = 0.5  # how often a thread that waits for room looks whether the command has ended


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    text = "print the items of all matching channels as one stream in the order of time, until Ctrl-C"
    sub = add_verb(subparsers, "sub", text, run_sub)
    sub.add_argument("glob", metavar="GLOB", help='names, such as "cam/*"; also channels that are created later')
    sub.add_argument(
        "--from",
        dest="start",
        type=checked(parse_bound_text),
        metavar="TIME",
        help="begin with the held items from this time on",
    )
    sub.add_argument("--count", type=parse_count, metavar="N", help="stop after N items")
    sub.add_argument(
        "--wait",
        type=timeout_seconds,
        default=0.1,
        metavar="DURATION",
        help="wait this long for a channel without items; its later items may be late; default 100ms",
    )
    add_item_options(sub)


def run_sub(arguments: argparse.Namespace) -> int:
    """Print items of many channels."""
    line = item_printer(arguments)
    with connected(arguments) as rt:
        stream = _Stream(rt, arguments)
        threading.Thread(target=stream.follow, daemon=True).start()
        try:
            for number, one in enumerate(stream.items(), 1):
                print(line(one.item, one.channel, one.late), flush=True)
                if number == arguments.count:
                    break
        finally:
            stream.end()
    print_dropped(stream.dropped)
    return 0


class _Stream:
    """The merge. For each channel, a thread puts the items of the channel into the merge."""

    def __init__(self, rt: Connection, arguments: argparse.Namespace) -> None:
        self._rt = rt
        self._glob = arguments.glob
        self._start: Bound | None = arguments.start
        self._payloads = not arguments.no_payloads
        self._merge = TimeMerge(arguments.wait)
        self._changed = threading.Condition()  # guards everything below
        self._ids: dict[str, bytes] = {}  # for each channel that a thread reads: the latest id from the directory
        self._error: StampedeError | None = None
        self._is_over = self._is_full = False
        self.dropped = 0

    def items(self) -> Iterator[MergedItem]:
        """Yield items until `end`. Raises the error that ended the watch of channels."""
        while True:
            with self._changed:
                found = self._merge.take(time.monotonic())
                if found is None:
                    if self._error is not None:
                        raise self._error
                    left_s = self._merge.due_s() - time.monotonic()
                    self._changed.wait(min(LOOK_S, max(0.001, left_s)) if left_s > 0 else LOOK_S)
                    continue
                self._changed.notify_all()  # there is room again
            yield found

    def end(self) -> None:
        """Let the threads end."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()

    def follow(self) -> None:
        """Read the matching channels, also channels that are created later. Runs on a thread of its own."""
        start = self._start
        try:
            while not self._is_over:
                with suppress(WatchRestart):
                    self._follow_from(start)
                start = OLDEST  # a channel that is created later is read from its first item on
        except StampedeError as error:
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _follow_from(self, start: Bound | None) -> None:
        with self._rt.watch(self._glob) as changes:
            for info in self._rt.channels(self._glob):
                self._begin(info, start)
            for change in changes:
                if isinstance(change.subject, ChannelInfo) and change.kind == "added":
                    self._begin(change.subject, OLDEST)

    def _begin(self, info: ChannelInfo, start: Bound | None) -> None:
        name = info.name
        with self._changed:
            if name in self._ids or self._is_over or len(self._ids) >= CHANNELS_MAX:
                self._note(info)
                return
            self._ids[name] = info.channel_id
            self._merge.join(name, time.monotonic())
        threading.Thread(target=self._read, args=(name, start), daemon=True).start()

    def _note(self, info: ChannelInfo) -> None:
        """Note a channel for the thread that reads its name. If there are too many channels, print a warning."""
        if info.name in self._ids:
            self._ids[info.name] = info.channel_id
        elif not self._is_full and not self._is_over:
            print(
                f"stampede: more than {CHANNELS_MAX} channels match {escaped(self._glob)}; the items of "
                f"{info.name} and further ones are not printed; narrow the glob",
                file=sys.stderr,
            )
            self._is_full = True

    def _read(self, name: str, start: Bound | None) -> None:
        """Read the channels of one name, one after the other. Runs on a thread of its own.

        The watch may report the next channel of that name before this thread learns that the former channel is deleted.
        """
        while True:
            channel_id = self._ids[name]
            self._read_channel(name, start)
            with self._changed:
                if self._ids[name] == channel_id or self._is_over:
                    del self._ids[name]
                    self._merge.leave(name)
                    self._changed.notify_all()
                    return
            start = OLDEST

    def _read_channel(self, name: str, start: Bound | None) -> None:
        """Read one channel until it is deleted, or until the end of the command."""
        try:
            while self._read_incarnation(name, start):
                start = OLDEST
        except ChannelNotFound:
            pass
        except StampedeError as error:
            if not (self._is_over or interruption.requested):  # Ctrl-C closes the connection
                print(f"stampede: {escaped(error.message)}", file=sys.stderr)

    def _read_incarnation(self, name: str, start: Bound | None) -> bool:
        """Read until the channel's items are lost with its host. Return whether to read later items."""
        channel = self._rt.channel(name, create=False)
        with channel.subscribe(start, payloads=self._payloads) as subscription:
            items = iter(subscription)
            try:
                while self._waits_for_room(name) and (item := next(items, None)) is not None:
                    self._offer(name, item)
            except IncarnationLost:
                return True
            finally:
                with self._changed:
                    self.dropped += subscription.dropped
        return False

    def _waits_for_room(self, name: str) -> bool:
        """Wait until the merge takes an item of the channel, before the thread fetches one. Returns False if the
        command has ended.
        """
        with self._changed:
            while not self._merge.has_room(name) and not self._is_over:
                self._changed.wait(LOOK_S)
            return not self._is_over

    def _offer(self, name: str, item: Item) -> None:
        with self._changed:
            if not self._is_over:
                self._merge.offer(name, item)
                self._changed.notify_all()
