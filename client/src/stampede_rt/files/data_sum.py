"""The checksum of the data of a file: of all bytes before its index."""

from __future__ import annotations

from mcap.opcode import Opcode
from mcap.records import DataEnd

from stampede_rt.files.framing import RecordFile


class DataSum:
    """Computes the checksum part by part.

    A reader adds each part just after it has read the part, because the operating system then still has these bytes in
    memory.
    """

    def __init__(self, records: RecordFile) -> None:
        self._records = records
        self._checksum = self._place = 0

    def read_to(self, end: int) -> None:
        """Add all bytes before the position `end` that are not in the checksum yet."""
        self._checksum = self._records.checksum(self._place, end, self._checksum)
        self._place = max(self._place, end)

    def is_stated_at(self, offset: int) -> bool:
        """Whether the record DataEnd at `offset` states the right checksum of all bytes before it, or 0: no checksum.

        Reads the bytes that `read_to` has not read. Raises FileError.
        """
        frame = self._records.frame_at(offset)
        if frame is None or frame.opcode != Opcode.DATA_END or frame.length != 4:
            return False
        stated = self._records.record(frame, DataEnd).data_section_crc
        if stated:
            self.read_to(offset)
        return stated in (0, self._checksum)
