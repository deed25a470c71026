"""The names that a replay does not have, and the reasons. Pure."""

from __future__ import annotations

_PRESENT = "a replay shows the past, and changes nothing: use the handle of the connection"
_PEERS = "queues, mailboxes and peers are not recorded: use the connection"
_CLUSTER = "the directory and the hosts keep no past: use the connection"
_FILES = "files have no virtual clock: use the connection"
_CUTS = "an event's time depended on unrecorded messages between hosts: use match(), or subscribe to group[channel]"

NOT_REPLAYED = {
    "Connection": {
        **dict.fromkeys(("queue", "mailbox", "send", "mailbox_stats", "mailbox_pending", "queues"), _PEERS),
        **dict.fromkeys(("peer", "peers", "watch_peers", "name"), _PEERS),
        **dict.fromkeys(("record", "replay_file", "import_file"), _FILES),
        **dict.fromkeys(("move", "move_queue", "rebalance", "drain", "proxy", "proxies", "remove_proxy"), _PRESENT),
        **dict.fromkeys(("channels", "groups", "hosts", "hosted_channels", "supernodes", "watch"), _CLUSTER),
        **dict.fromkeys(("cluster_id", "clock", "replay"), _CLUSTER),
    },
    "Channel": {
        **dict.fromkeys(("put", "producer", "sample", "consume", "advance", "configure", "delete"), _PRESENT),
        "stats": _CLUSTER,
    },
    "Group": {
        **dict.fromkeys(("add", "remove", "delete"), _PRESENT),
        "status": _CLUSTER,
        "subscribe": _CUTS,
    },
}
"""The public names of the live handles that a replay does not have, each with the reason, by the handle's class."""


def not_replayed(kind: str, name: str, handle: object) -> AttributeError:
    """Return the error for a name that a replayed handle does not have."""
    why = NOT_REPLAYED[kind].get(name)
    text = f"{type(handle).__name__!r} object has no attribute {name!r}"
    return AttributeError(text if why is None else f"{text}: {why}", name=name, obj=handle)
