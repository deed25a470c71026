# Generated from ../_async by tools/generate.py; do not edit.
"""Recordings: channels into files, and files into channels."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from stampede_rt._sync.moves import Moves
from stampede_rt.errors import InvalidArgument
from stampede_rt.transports.concurrency_sync import begin_if_blocking
from stampede_rt.values.policy import duration_of
from stampede_rt.values.timeline import (
    MAX_INSTANT,
    MIN_INSTANT,
    NOW,
    OLDEST,
    Bound,
    DurationLike,
    InstantLike,
    parse_instant,
)

if TYPE_CHECKING:
    from stampede_rt._sync.player import Player
    from stampede_rt._sync.reader import Reader
    from stampede_rt._sync.recorder import Recorder
    from stampede_rt.files.file_source import FileSource


OLDEST_ITEM = "oldest"  # the value of `since` for all items that the channels hold


class Files(Moves):
    """Records channels, and replays and imports files. Needs `stampede-rt[files]`."""

    def record(
        self,
        channels: str | Reader | Sequence[str | Reader],
        path: str | os.PathLike[str],
        *,
        since: DurationLike | None = None,
        for_: DurationLike | None = None,
        compression: str = "zstd",
        overwrite: bool = False,
    ) -> Recorder:
        """Record channels to an MCAP file at `path`, and return a handle with `stop`, `wait` and `summary`.

        `channels`: names, globs such as "rig/*", or handles. Channels that appear later are recorded, too, from their
        first item on. `since`: begin that far in the past, with the items that the channels still hold; "oldest": with
        all held items; None: with the items that the hosts accept from now on. `for_`: end after that time; None: at
        `stop`. `compression`: "zstd", "lz4" or "none". An existing file is not overwritten unless `overwrite` is True.

        The recording never delays a producer. The file and the summary name the items that retention collects before
        the recording has read them: for every channel accepted = recorded + missing. The recording keeps at most 1 MiB
        for each channel in memory, and two chunks of the file. This call returns when the recording of all present
        channels has begun; with asyncio, the handle for that. Raises FileError if the file cannot be made, or if
        `mcap` is not installed; InvalidArgument.
        """
        since_nanos = None if since == OLDEST_ITEM else duration_of("since", since, least=0)
        begin = OLDEST if since == OLDEST_ITEM else None if since_nanos is None else NOW - f"{since_nanos} ns"
        return self._record_from(begin, channels, path, for_=for_, compression=compression, overwrite=overwrite)

    def _record_from(
        self,
        begin: Bound | None,
        channels: str | Reader | Sequence[str | Reader],
        path: str | os.PathLike[str],
        *,
        for_: DurationLike | None,
        compression: str,
        overwrite: bool,
    ) -> Recorder:
        """Record the items from `begin` on, like `record`. None: the items that the hosts accept from now on."""
        from stampede_rt._sync.recorder import Recorder, parse_globs  # they load mcap
        from stampede_rt.files.writing import FileWriter

        self._session.check()
        for_nanos = duration_of("for_", for_, least=0)
        globs = parse_globs(channels)
        if not isinstance(overwrite, bool):
            raise InvalidArgument(f"overwrite is {overwrite!r}; write True or False")
        writer = FileWriter(path, compression=compression, overwrite=overwrite)
        for_s = None if for_nanos is None else for_nanos / 1e9
        recorder = Recorder(self._session, self, globs, writer, begin, for_s)
        begin_if_blocking(recorder._wait_for_start)
        return recorder

    def replay_file(
        self,
        path: str | os.PathLike[str],
        prefix: str = "replay/",
        *,
        channels: str | Sequence[str] = "*",
        speed: float = 1.0,
        start: InstantLike | None = None,
        end: InstantLike | None = None,
        loop: bool = False,
        shift: DurationLike | None = None,
    ) -> Player:
        """Play a file into channels, and return a handle with `stop`, `wait` and `summary`.

        Each topic that matches `channels` becomes the channel of its name with `prefix` before it. Items come in the
        order and at the pace at which they came, `speed` times as fast; 0: as fast as possible. The replay takes only
        items with recorded times from `start` on and before `end`. `loop`: play again and again, until `stop`.

        `shift`: "now" moves all times by the same amount, so that the items come as if they were new. Durations and
        distances stay. At a speed above 1 the replay is shorter than the recording, and the time of the first item is
        in the past by the difference. A duration such as "-1h" moves all times by this duration; None keeps the
        recorded times. If a channel does not exist, the replay creates it with its recorded policy, but without a
        shift it gets no max_age.

        The call returns when all channels are open; with asyncio, the handle for that. Raises InvalidArgument,
        before the first item, if a channel would refuse the items; FileError.
        """
        from stampede_rt.files.sources import McapSource

        if not isinstance(loop, bool):
            raise InvalidArgument(f"loop is {loop!r}; write True or False")
        if loop and (shift != "now" or not 0 < speed <= 1):
            raise InvalidArgument(
                'a loop needs shift="now" and a speed of at most 1; otherwise its times go back, or reach the future'
            )
        return self._play(lambda: McapSource(path), prefix, channels, speed, start, end, loop, shift)

    def import_file(
        self,
        path: str | os.PathLike[str],
        prefix: str = "",
        *,
        channels: str | Sequence[str] = "*",
        start: InstantLike | None = None,
        end: InstantLike | None = None,
        shift: DurationLike | None = None,
    ) -> Player:
        """Put the items of a file into channels, as fast as possible. The file is MCAP, rosbag2 or XDF.

        A rosbag2 is a folder with metadata.yaml (with sqlite3 or MCAP), or a file in it; its items are messages in CDR.
        Rosbag2 and XDF need `stampede-rt[imports]`. The other arguments, the result and the errors are as in
        `replay_file`.
        """
        from stampede_rt.files.foreign import source_of

        return self._play(lambda: source_of(path), prefix, channels, 0, start, end, False, shift)

    def _play(
        self,
        opened: Callable[[], FileSource],
        prefix: str,
        channels: str | Sequence[str],
        speed: float,
        start: InstantLike | None,
        end: InstantLike | None,
        loop: bool,
        shift: DurationLike | None,
    ) -> Player:
        from stampede_rt._sync.player import Player, PlayRequest
        from stampede_rt.files.names import matches_any
        from stampede_rt.files.schedule import parse_shift, parse_speed

        self._session.check()
        request = PlayRequest(
            prefix=prefix,
            chosen=matches_any([channels] if isinstance(channels, str) else channels),
            speed=parse_speed(speed),
            start=MIN_INSTANT if start is None else parse_instant(start, "start"),
            end=MAX_INSTANT if end is None else parse_instant(end, "end"),
            loop=loop,
            shift=parse_shift(shift),
        )
        player = Player(self._session, opened(), request)
        begin_if_blocking(player._wait_for_start)
        return player
