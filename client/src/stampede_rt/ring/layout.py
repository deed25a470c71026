"""The layout of a ring in shared memory (`shared_memory.proto`). This module does no I/O.

A ring has the latest items of one channel. The host writes the ring, and readers on the same machine read it without
a call.

The memory has a header, an array of slots, and an area of data. The header and the slots are words of 8 bytes, signed,
in the byte order of the machine. Both sides read and write each word as a whole, through `memoryview.cast("q")`. On
x86-64 each such access is atomic. If one processor writes several words, another processor sees the writes in the
order in which the first one made them.

A run is a sequence of items that the channel accepted together. Its bytes are in the area of data. Its slot says where
they are, and which seqs and times the items have. The facts are the words of the header that change with each run.
The host writes a run in this order: TAIL, the bytes of the run, its slot, and then the facts, of which HEAD is one.
A reader copies the bytes of a run, and then reads TAIL a second time. If TAIL is now greater than the number of the
slot, the host may have overwritten the bytes during the copy, so the reader must not use the copy.
"""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt.errors import InvalidArgument

MAGIC = int.from_bytes(b"STAMPRNG", "little")
LAYOUT_VERSION = 1
HEADER_WORDS = 512
SLOT_WORDS = 8
WORD_BYTES = 8
RING_BYTES_MAX = 80 * 2**20  # the host's largest ring has 64 MiB of data, and fewer bytes of slots
ABSENT_INSTANT = -(2**63)
"""The word for an absent instant."""

# Each slot has a number: 0 for the first slot that the host wrote, and then 1 more for each. Slot N is in the array at
# the index N modulo the number of slots.

# Words that the host writes once, when it makes the ring.
MAGIC_WORD, VERSION_WORD, SLOTS_WORD, DATA_BYTES_WORD, INCARNATION_WORD = range(5)
STATE_WORD = 5  # OPEN, or CLOSED: the host never writes this ring again
FENCE_WORD = 6  # the host may serve until this instant, in nanoseconds of CLOCK_BOOTTIME
TAIL_WORD = 7  # the number of the first slot whose bytes are whole

# The facts. SEQUENCE_WORD is odd while the host writes them.
SEQUENCE_WORD = 8
FACTS_END = 24
# The places of the facts after SEQUENCE_WORD:
HEAD = 1  # how many slots the host has written so far
NEWEST_SLOT = 2  # the number of the slot whose last item is the newest item, or NO_ITEMS, or NOT_HERE
NEWEST_TIME = 3  # the newest item's time
NEXT_SEQ = 4  # the seq of the next accepted item
# From the slot with this number on, each item is later than the item before it, also from one slot to the next. The
# channel holds no other item between these items.
ORDERED_FROM = 5
LATEST_ADVANCE = 6  # the greatest instant that a producer has promised to put no items before; or ABSENT_INSTANT
# Items before this instant may be missing, because retention has removed ("collected") them or a host was lost.
GONE_BEFORE = 7  # ABSENT_INSTANT: no items are missing
FLOOR_TIME = 8  # items below (FLOOR_TIME, FLOOR_SEQ) were collected
FLOOR_SEQ = 9
MAX_AGE = 10  # the channel's max_age in nanoseconds; -1: none
CLOCK_BOOTTIME = 11  # a reading of CLOCK_BOOTTIME
CLOCK_HOST = 12  # the host's clock at the moment of this reading
CLOCK_OFFSET = 13  # the machine's wall clock minus the host's clock at that moment
LATE = 14  # the number of slots whose first item was older than the newest item
RECORDED = 15  # 1: an archive may have the items before GONE_BEFORE. Hosts of earlier releases always write 0

CHANGES_WORD = 32  # the host adds 1 after each change; its lower half is the futex on which readers wait

# The words of a slot.
SEQ, ITEMS, FIRST_TIME, LAST_TIME, OFFSET, LENGTH, DURATION, PAYLOAD = range(8)
# DURATION and PAYLOAD describe a run of one item. DURATION is the item's duration or -1. PAYLOAD has the length of the
# payload in its upper 48 bits. Its lower 16 bits are the position in the run at which the payload begins. If PAYLOAD is
# 0, the item has labels (a content type or attributes), and readers decode the whole run.
PAYLOAD_BEGIN_MAX = 0xFFFF

OPEN, CLOSED = 1, 2
NO_ITEMS, NOT_HERE = -1, -2  # NO_ITEMS: the channel has no items. NOT_HERE: the ring does not have the newest item


class RingSize(NamedTuple):
    """The size of a ring. `slots` is a power of two.

    OFFSET never wraps: the byte with offset N is at N modulo `data_bytes` of the data.
    """

    slots: int
    data_bytes: int

    @property
    def data_begin(self) -> int:
        """The position of the data in the memory, in bytes."""
        return (HEADER_WORDS + self.slots * SLOT_WORDS) * WORD_BYTES

    @property
    def whole_bytes(self) -> int:
        """The size of the memory."""
        return self.data_begin + self.data_bytes


def words_of(memory: memoryview) -> memoryview:
    """Return the memory as words. Its length is a multiple of 8 bytes."""
    return memory.cast("q")


def size_of(memory: memoryview) -> RingSize:
    """Return the size that a mapped ring states. Raises InvalidArgument if the memory is not a ring of this layout."""
    if len(memory) < HEADER_WORDS * WORD_BYTES or len(memory) % WORD_BYTES or len(memory) > RING_BYTES_MAX:
        raise InvalidArgument(f"the shared memory of {len(memory)} bytes holds no ring")
    words = words_of(memory)
    if words[MAGIC_WORD] != MAGIC or words[VERSION_WORD] != LAYOUT_VERSION:
        raise InvalidArgument("the memory is not a ring of this version; install the same release on both sides")
    size = RingSize(words[SLOTS_WORD], words[DATA_BYTES_WORD])
    if size.slots < 1 or size.slots & (size.slots - 1) or size.data_bytes < WORD_BYTES:
        raise InvalidArgument(f"a ring has {size.slots} slots and {size.data_bytes} bytes of data; it is damaged")
    if size.whole_bytes != len(memory):
        raise InvalidArgument(f"a ring of {size.whole_bytes} bytes is in memory of {len(memory)} bytes; it is damaged")
    return size
