"""The names, help texts and labels of a host's metrics. Pure.

A metric without a label for the name is the sum over all channels, queues or groups of the host. A metric with such a
label has at most NAMES_MAX values of it.
"""

from __future__ import annotations

from stampede_rt_runtime.metrics.families import Metric, counter, gauge

NAMES_MAX = 100
"""The most channels, queues, groups and subscriptions that have metrics of their own."""
HOLDERS_MAX = 4
"""The most members that the metrics name as the holders of one group's cut."""

LEASE_HELD = gauge("stampede_host_lease_held", "1 if the host has its lease and may serve, else 0.")
LEASE_REMAINING = gauge(
    "stampede_host_lease_remaining_seconds", "How long the host may still serve if its lease is not renewed."
)
MEMORY_HELD = gauge("stampede_host_memory_held_bytes", "Memory that all channels and queues of the host take.")
MEMORY_LIMIT = gauge("stampede_host_memory_limit_bytes", "The most memory that channels and queues may take.")
CHANNELS = gauge("stampede_host_channels", "Channels that callers have bound at this host.")
QUEUES = gauge("stampede_host_queues", "Queues, mailboxes included, that callers have used at this host.")
GROUPS = gauge("stampede_host_groups", "Groups that the host knows.")

ITEMS_ACCEPTED = counter("stampede_items_accepted_total", "Items that all channels accepted.")
ITEMS_ACCEPTED_BYTES = counter("stampede_items_accepted_bytes_total", "Payload bytes of all accepted items.")
ITEMS_DELIVERED = counter("stampede_items_delivered_total", "Items that were sent to readers, once for each reader.")
ITEMS_DELIVERED_BYTES = counter("stampede_items_delivered_bytes_total", "Payload bytes that were sent to readers.")
ITEMS_HELD = gauge("stampede_items_held", "Items that all channels hold now.")
ITEMS_HELD_BYTES = gauge("stampede_items_held_bytes", "Payload bytes of all held items.")
ITEMS_COLLECTED = counter(
    "stampede_items_collected_total",
    "Items that retention took out, by the cause: age, count, bytes, or consumption by all consumers.",
    "cause",
)
ITEMS_REJECTED = counter(
    "stampede_items_rejected_total",
    "Items that channels refused, by the cause, such as too_old, in_future, channel_full or overloaded.",
    "cause",
)
ITEMS_LATE = counter("stampede_items_late_total", "Accepted items that came after an item with a later time.")
ITEMS_DROPPED = counter(
    "stampede_items_dropped_total",
    "Items that subscriptions did not get: collected before they took them, or skipped for a newer item.",
    "cause",
)
MULTICAST_CHANNELS = gauge("stampede_multicast_channels", "Channels that the host sends as multicast datagrams now.")
MULTICAST_READERS = gauge(
    "stampede_multicast_readers", "Open subscriptions whose readers may take the items from datagrams."
)
MULTICAST_DATAGRAMS = counter("stampede_multicast_datagrams_total", "Multicast datagrams sent.")
MULTICAST_BYTES = counter(
    "stampede_multicast_bytes_total", "Bytes of the sent datagrams, without the headers of UDP and IP."
)
MULTICAST_UNSENT = counter("stampede_multicast_unsent_total", "Datagrams that the machine did not take.")
MULTICAST_REPAIRS = counter(
    "stampede_multicast_repairs_total", "Requests of readers for items that no datagram brought them."
)
ITEMS_UNARCHIVED = counter(
    "stampede_items_unarchived_total", "Items of recorded channels that max_bytes collected before they were archived."
)
ARCHIVE_BACKLOG = gauge("stampede_archive_backlog_items", "Accepted items that are not archived yet.")
ARCHIVE_BYTES = gauge(
    "stampede_archive_bytes", "Bytes of the archive on its disk, with the bytes that are not written yet."
)
ARCHIVE_LIMIT = gauge("stampede_archive_limit_bytes", "The most bytes that the archive may use on its disk.")
ARCHIVE_FAILING = gauge("stampede_archive_failing", "1 while the archive cannot be written, else 0.")
ARCHIVE_DAMAGED = counter(
    "stampede_archive_damaged_blocks_total", "Damaged blocks that reads of the archive have found."
)
STORE_OBJECTS = gauge(
    "stampede_archive_store_objects", "Objects that the object store has of the channels that the host records."
)
STORE_BYTES = gauge("stampede_archive_store_bytes", "Bytes of the channels' objects in the object store.")
STORE_WAITING = gauge(
    "stampede_archive_store_waiting_bytes", "Bytes of closed files that have not moved to the object store."
)
STORE_MOVED = counter(
    "stampede_archive_store_moved_bytes_total", "Bytes of closed files that moved to the object store."
)
STORE_FETCHED = counter("stampede_archive_store_fetched_bytes_total", "Bytes that reads fetched from the object store.")
STORE_FAILURES = counter(
    "stampede_archive_store_failures_total", "Attempts to move closed files in which the object store failed."
)
STORE_CACHE = gauge("stampede_archive_cache_bytes", "Bytes of objects that the host keeps on its disk for reads.")
OF_OBJECT_STORES = (
    STORE_OBJECTS, STORE_BYTES, STORE_WAITING, STORE_MOVED, STORE_FETCHED, STORE_FAILURES, STORE_CACHE,
)  # fmt: skip
SUBSCRIPTIONS = gauge("stampede_subscriptions_open", "Open subscriptions to channels and groups.")
GETS_WAITING = gauge("stampede_gets_waiting", "Gets that wait for an item.")
PUTS_WAITING = gauge("stampede_puts_waiting", "Puts that wait for room.")
SUBSCRIPTION_DROPPED = counter(
    "stampede_subscription_items_dropped_total",
    "Items that one open subscription did not get; only the subscriptions that missed the most.",
    "source",
    "subscriber",
    "cause",
)

CHANNEL_ACCEPTED = counter("stampede_channel_items_accepted_total", "Items that the channel accepted.", "channel")
CHANNEL_ACCEPTED_BYTES = counter(
    "stampede_channel_items_accepted_bytes_total", "Payload bytes of the channel's accepted items.", "channel"
)
CHANNEL_DELIVERED_BYTES = counter(
    "stampede_channel_items_delivered_bytes_total", "Payload bytes that were sent to the channel's readers.", "channel"
)
CHANNEL_HELD = gauge("stampede_channel_items_held", "Items that the channel holds now.", "channel")
CHANNEL_HELD_BYTES = gauge("stampede_channel_items_held_bytes", "Payload bytes of the channel's held items.", "channel")
CHANNEL_COLLECTED = counter(
    "stampede_channel_items_collected_total", "Items of the channel that retention took out.", "channel", "cause"
)
CHANNEL_REJECTED = counter(
    "stampede_channel_items_rejected_total", "Items that the channel refused, by the cause.", "channel", "cause"
)
CHANNEL_LATE = counter(
    "stampede_channel_items_late_total", "Accepted items that came after an item with a later time.", "channel"
)
CHANNEL_NEWEST_AGE = gauge(
    "stampede_channel_newest_item_age_seconds",
    "How far the time of the newest held item is behind the host's clock; below 0 if it is ahead.",
    "channel",
)
CHANNEL_SUBSCRIPTIONS = gauge("stampede_channel_subscriptions_open", "Open subscriptions of the channel.", "channel")

QUEUE_EVENTS = counter(
    "stampede_queue_messages_total",
    "Steps of the messages of all queues: accepted, delivered, consumed, given_back, leases_expired, "
    "terminated, dropped, dead_lettered, expelled or duplicates.",
    "event",
)
QUEUE_REJECTED = counter("stampede_queue_messages_rejected_total", "Messages that queues refused.", "cause")
QUEUE_BYTES = counter("stampede_queue_accepted_bytes_total", "Payload bytes of all accepted messages.")
QUEUE_HELD = gauge("stampede_queue_messages_held", "Messages that all queues hold, leased ones included.")
QUEUE_LEASED = gauge("stampede_queue_messages_leased", "Messages that takers work on now.")
ONE_QUEUE_HELD = gauge("stampede_queue_depth_messages", "Messages that the queue holds, leased ones included.", "queue")
ONE_QUEUE_LEASED = gauge("stampede_queue_leased_messages", "Messages of the queue that takers work on now.", "queue")
ONE_QUEUE_AGE = gauge(
    "stampede_queue_oldest_message_age_seconds", "How long ago the queue accepted its oldest held message.", "queue"
)
ONE_QUEUE_DEAD = counter(
    "stampede_queue_dead_lettered_messages_total", "Messages that the queue moved to its dead-letter queue.", "queue"
)
ONE_QUEUE_TAKERS = gauge("stampede_queue_takers_waiting", "Takers that wait for a message of the queue.", "queue")

CUT_LAG_MAX = gauge("stampede_groups_cut_lag_max_seconds", "The greatest cut lag of all groups that have a cut.")
GROUPS_WITHOUT_CUT = gauge("stampede_groups_without_cut", "Groups that show nothing yet, because they have no cut.")
CUT_LAG = gauge("stampede_group_cut_lag_seconds", "How far the group's cut is behind the host's clock.", "group")
CUT_HELD_BY = gauge(
    "stampede_group_cut_held_by",
    "1 for each member that holds back the group's cut now; at most 4 of a group.",
    "group",
    "channel",
)

METRICS: tuple[Metric, ...] = tuple(one for one in [*globals().values()] if isinstance(one, Metric))
