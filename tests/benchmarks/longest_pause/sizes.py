"""The sizes of the cases with `--share 1`, the default."""

ITEMS = 500_000
LATE_ITEMS = 300_000
BUCKET_ITEMS = 50_000  # the items of one bucket, which have the same time
BLOCKED_GETS = 10_000
CALLS = 1000  # blocked gets on one stream
CHANNELS = 20_000
CHANNELS_NAMED = 999  # the channels that a registration names
HELD_CHANNELS = 100_000
QUEUED_ITEMS = 100_000
RUN_ITEMS = 200  # in each run of two producers that interleave
SUBSCRIBERS = 1000
FOLLOWED_ITEMS = 5  # the items that each subscriber reads
GROUP_READERS = 4096
PAGE_ITEMS = 100
READ_ITEMS = 20_000  # the items that one subscriber reads, the oldest first
REPLACED_ITEMS = 200_000
PUTS_PER_TURN = 20
MORE_OBJECTS = 40_000
WATCHES = 1000
WATCHED_CHANGES = 5
