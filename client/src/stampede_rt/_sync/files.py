# Generated from ../_async by tools/generate.py; do not edit.
"""Recordings: channels into files, and files into channels."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from stampede_rt._sync.proxies import Proxies
from stampede_rt.errors import InvalidArgument
from stampede_rt.transports.concurrency_sync import begin_if_blocking
from stampede_rt.values.policy import duration_of
from stampede_rt.values.timeline import DurationLike

if TYPE_CHECKING:
    from stampede_rt._sync.reader import Reader
    from stampede_rt._sync.recorder import Recorder


class Files(Proxies):
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
        oldest item on. `since`: begin that far in the past, with the items that the channels still hold; None: with the
        items that come from now on. `for_`: end after that time; None: at `stop`. `compression`: "zstd", "lz4" or
        "none". An existing file is not overwritten unless `overwrite` is True.

        The recording never delays a producer. What retention collects before the recording has read it is named in the
        file and in the summary: for every channel accepted = recorded + missing. The recording keeps at most 1 MiB for
        each channel in memory, and two chunks of the file. This call returns when all present channels are recorded;
        with asyncio, the handle for that. Raises FileError if the file cannot be made, or if `mcap` is not
        installed; InvalidArgument.
        """
        from stampede_rt._sync.recorder import Recorder, parse_globs  # they load mcap
        from stampede_rt.files.writing import FileWriter

        self._session.check()
        since_nanos = duration_of("since", since, least=0)
        for_nanos = duration_of("for_", for_, least=0)
        globs = parse_globs(channels)
        if not isinstance(overwrite, bool):
            raise InvalidArgument(f"overwrite is {overwrite!r}; write True or False")
        writer = FileWriter(path, compression=compression, overwrite=overwrite)
        for_s = None if for_nanos is None else for_nanos / 1e9
        recorder = Recorder(self._session, self, globs, writer, since_nanos, for_s)
        begin_if_blocking(recorder._begun)
        return recorder
