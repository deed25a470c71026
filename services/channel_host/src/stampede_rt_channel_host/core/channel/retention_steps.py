"""The bounds of the work that one call of `Retention` does. Pure."""

SLICES_CONSUMED_MAX = 64
"""The most slices that one call collects by consumption, so that a consumer that catches up delays no other caller."""
BACKLOG_ENTRIES_MAX = 512
"""With this number of entries of outdated items, or more, consumption collects nothing: a late item may have to free
all of them, and to copy them for the reads that still show them.
"""
AFTER_READS_NANOS = 100 * 10**6
"""If long reads keep these entries, consumption looks again after this time."""
SLICES_AGED_MAX = 256
"""The most slices that one call checks for items that a consumer has still to consume. Only `max_age_unconsumed` needs
this check.
"""
