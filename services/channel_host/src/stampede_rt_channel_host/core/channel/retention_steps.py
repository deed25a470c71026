"""The bounds of the work that one call of `Retention` does. Pure."""

SLICES_CONSUMED_MAX = 64
"""The most slices that one call collects by consumption, so that a consumer that catches up delays no other caller."""
BACKLOG_ENTRIES_MAX = 512
"""While outdated items still have this number of entries or more, consumption collects nothing. Otherwise the put of
a late item might have to free too many entries in one call, and to copy them for the reads that still show them.
"""
READS_RETRY_NANOS = 100 * 10**6
"""If long reads still need BACKLOG_ENTRIES_MAX outdated entries, consumption tries to collect again after this time."""
SLICES_AGED_MAX = 256
"""The most slices that one call checks for items that a consumer has still to consume. Only `max_age_unconsumed` needs
this check.
"""
