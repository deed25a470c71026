"""All attacks, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tests.benchmarks.attacks import (
    members,
    memory,
    neighbours,
    over_sockets,
    over_tcp,
    quotas,
    readers,
    without_credential,
)
from tests.benchmarks.attacks.attacked_cluster import Attack

Part = Literal["host", "supernode"]


@dataclass(frozen=True)
class Case:
    """One attack.

    `before`: the finding of a review before the defence. `watched`: the part whose memory the table shows. `transport`:
    the transport of the good clients; empty: the usual one. `secured`: whether the cluster has certificates.
    """

    attack: Attack
    before: str = "not tried"
    watched: Part = "host"
    transport: str = ""
    secured: bool = False

    @property
    def text(self) -> str:
        """The attack in a sentence."""
        return " ".join((self.attack.__doc__ or "").split()).rstrip(".")


CASES: dict[str, Case] = {
    "health-headers": Case(
        without_credential.health_headers, "everybody else RESOURCE_EXHAUSTED, hosts fenced after 2.6 s"
    ),
    "unfinished-health": Case(without_credential.unfinished_health, "51 to 1057 MiB"),
    "resets": Case(without_credential.resets, "148 of 218 good calls failed, a lease lost"),
    "idle-connections": Case(without_credential.idle_connections, "everybody locked out"),
    "malformed": Case(without_credential.malformed, "747 bytes of log for each"),
    "unfinished-puts": Case(without_credential.unfinished_puts, "54 to 1057 MiB"),
    "unfinished-messages": Case(without_credential.unfinished_messages),
    "health-watches": Case(neighbours.health_watches, "all slots held"),
    "repeated-fields": Case(memory.repeated_fields, "+652 MiB"),
    "attributes": Case(memory.attributes, "+312 MiB"),
    "refused-runs": Case(memory.refused_runs, "+158 MiB"),
    "late-clock": Case(memory.late_clock, "200 MiB in 15 s"),
    "waiting-puts": Case(memory.waiting_puts, "+1232 MiB; 1399 MiB stayed until decision 0101"),
    "waiting-enqueues": Case(memory.waiting_enqueues),
    "silent-subscriptions": Case(memory.silent_subscriptions, "+584 MiB"),
    "silent-gets": Case(memory.silent_gets),
    "silent-takers": Case(memory.silent_takers),
    "silent-cuts": Case(neighbours.silent_cuts),
    "silent-watches": Case(neighbours.silent_watches, watched="supernode"),
    "unknown-fields": Case(memory.unknown_fields, "+275 MiB by 64 gets with 4 MiB"),
    "large-gets": Case(neighbours.large_gets, "p50 2 s, the lease lost; 4.0 x without turns"),
    "many-subscriptions": Case(neighbours.many_subscriptions, "p50 572 ms; 32.1 x without turns"),
    "new-channels": Case(neighbours.new_channels, "98 % CPU, 3.7 KB kept for each", "supernode"),
    "new-groups": Case(neighbours.new_groups, watched="supernode"),
    "new-queues": Case(neighbours.new_queues, watched="supernode"),
    "new-peers": Case(neighbours.new_peers, watched="supernode"),
    "many-streams": Case(quotas.many_streams),
    "blocked-gets": Case(quotas.blocked_gets, "4.5 x without turns"),
    "busy-puts": Case(quotas.busy_puts, "9.6 x without turns"),
    "single-calls": Case(quotas.single_calls),
    "held-bytes": Case(quotas.held_bytes),
    "archived-bytes": Case(quotas.archived_bytes, "the disk full"),
    "many-cuts": Case(readers.many_cuts),
    "many-matches": Case(readers.many_matches),
    "busy-takes": Case(readers.busy_takes),
    "silent-sockets": Case(over_sockets.silent_sockets),
    "unfinished-frames": Case(over_sockets.unfinished_frames),
    "malformed-frames": Case(over_sockets.malformed_frames),
    "tcp-silent": Case(over_tcp.tcp_silent, transport="tcp"),
    "tcp-unfinished": Case(over_tcp.tcp_unfinished, transport="tcp"),
    "tcp-malformed": Case(over_tcp.tcp_malformed, transport="tcp"),
    "tcp-silent-gets": Case(over_tcp.tcp_silent_gets, transport="tcp"),
    "tcp-half-closed": Case(over_tcp.tcp_half_closed, transport="tcp"),
    "tls-unfinished": Case(over_tcp.tls_unfinished, transport="tcp", secured=True),
    "tls-hellos": Case(over_tcp.tls_hellos, transport="tcp", secured=True),
    "tls-malformed": Case(over_tcp.tls_malformed, transport="tcp", secured=True),
    "raft-claims": Case(members.raft_claims, "no leader for ever; the leader's process ended", "supernode"),
    "join-tokens": Case(members.join_tokens, "a new member with a forged token", "supernode"),
    "cut-floors": Case(members.cut_floors, "the cut at the end of time"),
    "globs": Case(members.globs, "the lease lost; with 24 stars the host hung for ever"),
}
