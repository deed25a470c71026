"""The note that a host leaves when it stops: the archive has all items of a channel. The functions block."""

from __future__ import annotations

import json
import os
import re
from base64 import b64decode, b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

from stampede_rt_channel_host.archive.stable_writes import sync_folder
from stampede_rt_channel_host.core.archive import Segment

_FILE = "stopped-cleanly"
_INSTANT = r"(x|-?\d{1,19})"
_NAME = re.compile("_".join([r"(\d{1,20})", r"(\d{1,20})", *[_INSTANT] * 3]) + r"\.stopped")


class CleanStop(NamedTuple):
    """The facts about a channel that its items do not have, as of the moment at which its host stopped.

    `epoch` and `incarnation` are the channel's at that moment. `lost_from` and `lost_before` are the bounds of an
    earlier loss, or None. `retries` is the encoded retry window of the producers. The archive had all seqs below
    `end_seq`, and no item later than `newest`; 0 and None: not known. A starting host compares `end_seq` and `newest`
    with the files, and so notices a damaged last block.
    """

    incarnation: int
    advance: int | None = None
    lost_from: int | None = None
    lost_before: int | None = None
    retries: bytes = b""
    epoch: int = 0
    end_seq: int = 0
    newest: int | None = None

    def at_end(self, segments: Sequence[Segment], epoch: int) -> CleanStop:
        """The note of a host that stops in this epoch with these segments."""
        end_seq = max((one.end_seq for one in segments), default=0)
        newest = max((one.high[0] for one in segments if one.high is not None), default=None)
        return self._replace(epoch=epoch, end_seq=end_seq, newest=newest)

    def is_of(self, incarnation: int, epoch: int) -> bool:
        """Whether the note is still true for a channel with this incarnation and epoch.

        The note is true if no other host has served the channel since the stop, and each process that served it has
        stopped cleanly. The directory keeps the incarnation over clean stops. If the directory has changed the
        incarnation, it may have raised the epoch by one.
        """
        return self.incarnation == incarnation or self.epoch in (epoch - 1, epoch)


class OwnPart(NamedTuple):
    """The last items of an archive, which this host has accepted and still has on its disk: from the seq `first_seq`
    on, accepted from the instant `accepted` on.
    """

    first_seq: int
    accepted: int


def name_of_stop(stop: CleanStop) -> str:
    """The name of an object that notes a clean stop for the next owner of the channel.

    The name has no incarnation, no advance and no retries, because the directory gives a new incarnation to the channel
    if another host takes it over.
    """
    instants = ("x" if one is None else str(one) for one in (stop.newest, stop.lost_from, stop.lost_before))
    return "_".join([f"{stop.epoch:09}", str(stop.end_seq), *instants]) + ".stopped"


def stop_named(name: str) -> CleanStop | None:
    """The clean stop that the object of this name reports, or None if the object reports no clean stop."""
    found = _NAME.fullmatch(name)
    if found is None:
        return None
    epoch, end_seq, *instants = found.groups()
    newest, lost_from, lost_before = (None if one == "x" else int(one) for one in instants)
    stop = CleanStop(0, None, lost_from, lost_before, b"", int(epoch), int(end_seq), newest)
    return stop if name_of_stop(stop) == name else None


def write_stop(folder: Path, stop: CleanStop) -> None:
    """Write the note, and bring it to stable storage. Raises OSError."""
    facts = json.dumps({**stop._asdict(), "retries": b64encode(stop.retries).decode()}).encode()
    with (folder / _FILE).open("wb") as file:
        file.write(b"%08x %b" % (crc32(facts), facts))
        file.flush()
        os.fsync(file.fileno())
    sync_folder(folder)


def read_stop(folder: Path) -> CleanStop | None:
    """The note, or None if it is missing, damaged or cannot be read. Raises OSError.

    A note without a checksum is of an earlier release.
    """
    try:
        content = (folder / _FILE).read_bytes()
        checksum, _, text = (b"", b"", content) if content.startswith(b"{") else content.partition(b" ")
        if checksum and checksum != b"%08x" % crc32(text):
            return None
        facts = json.loads(text)
        stop = CleanStop(**{**facts, "retries": b64decode(facts["retries"])})
    except (FileNotFoundError, ValueError, TypeError, KeyError):
        return None
    is_sound = all(isinstance(one, int) for one in (stop.incarnation, stop.epoch, stop.end_seq))
    return stop if is_sound and isinstance(stop.newest, int | None) else None


def remove_stop(folder: Path) -> None:
    """Remove the note: from now on the channel takes items. Raises OSError."""
    (folder / _FILE).unlink(missing_ok=True)
