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
class AttackCase:
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


CASES: dict[str, AttackCase] = {
    "health-headers": AttackCase(
        without_credential.health_headers, "everybody else RESOURCE_EXHAUSTED, hosts fenced after 2.6 s"
    ),
    "unfinished-health": AttackCase(without_credential.unfinished_health, "51 to 1057 MiB"),
    "resets": AttackCase(without_credential.resets, "148 of 218 good calls failed, a lease lost"),
    "idle-connections": AttackCase(without_credential.idle_connections, "everybody locked out"),
    "malformed": AttackCase(without_credential.malformed, "747 bytes of log for each"),
    "unfinished-puts": AttackCase(without_credential.unfinished_puts, "54 to 1057 MiB"),
    "unfinished-messages": AttackCase(without_credential.unfinished_messages),
    "health-watches": AttackCase(neighbours.health_watches, "all slots held"),
    "repeated-fields": AttackCase(memory.repeated_fields, "+652 MiB"),
    "attributes": AttackCase(memory.attributes, "+312 MiB"),
    "refused-runs": AttackCase(memory.refused_runs, "+158 MiB"),
    "late-clock": AttackCase(memory.late_clock, "200 MiB in 15 s"),
    "waiting-puts": AttackCase(memory.waiting_puts, "+1232 MiB; 1399 MiB stayed until decision 0101"),
    "waiting-enqueues": AttackCase(memory.waiting_enqueues),
    "silent-subscriptions": AttackCase(memory.silent_subscriptions, "+584 MiB"),
    "silent-gets": AttackCase(memory.silent_gets),
    "silent-takers": AttackCase(memory.silent_takers),
    "silent-cuts": AttackCase(neighbours.silent_cuts),
    "silent-watches": AttackCase(neighbours.silent_watches, watched="supernode"),
    "unknown-fields": AttackCase(memory.unknown_fields, "+275 MiB by 64 gets with 4 MiB"),
    "large-gets": AttackCase(neighbours.large_gets, "p50 2 s, the lease lost; 4.0 x without turns"),
    "many-subscriptions": AttackCase(neighbours.many_subscriptions, "p50 572 ms; 32.1 x without turns"),
    "new-channels": AttackCase(neighbours.new_channels, "98 % CPU, 3.7 KB kept for each", "supernode"),
    "new-groups": AttackCase(neighbours.new_groups, watched="supernode"),
    "new-queues": AttackCase(neighbours.new_queues, watched="supernode"),
    "new-peers": AttackCase(neighbours.new_peers, watched="supernode"),
    "many-streams": AttackCase(quotas.many_streams),
    "blocked-gets": AttackCase(quotas.blocked_gets, "4.5 x without turns"),
    "busy-puts": AttackCase(quotas.busy_puts, "9.6 x without turns"),
    "single-calls": AttackCase(quotas.single_calls),
    "held-bytes": AttackCase(quotas.held_bytes),
    "archived-bytes": AttackCase(quotas.archived_bytes, "the disk full"),
    "many-cuts": AttackCase(readers.many_cuts),
    "many-matches": AttackCase(readers.many_matches),
    "busy-takes": AttackCase(readers.busy_takes),
    "silent-sockets": AttackCase(over_sockets.silent_sockets),
    "unfinished-frames": AttackCase(over_sockets.unfinished_frames),
    "malformed-frames": AttackCase(over_sockets.malformed_frames),
    "tcp-silent": AttackCase(over_tcp.tcp_silent, transport="tcp"),
    "tcp-unfinished": AttackCase(over_tcp.tcp_unfinished, transport="tcp"),
    "tcp-malformed": AttackCase(over_tcp.tcp_malformed, transport="tcp"),
    "tcp-silent-gets": AttackCase(over_tcp.tcp_silent_gets, transport="tcp"),
    "tcp-half-closed": AttackCase(over_tcp.tcp_half_closed, transport="tcp"),
    "tls-unfinished": AttackCase(over_tcp.tls_unfinished, transport="tcp", secured=True),
    "tls-hellos": AttackCase(over_tcp.tls_hellos, transport="tcp", secured=True),
    "tls-malformed": AttackCase(over_tcp.tls_malformed, transport="tcp", secured=True),
    "raft-claims": AttackCase(members.raft_claims, "no leader for ever; the leader's process ended", "supernode"),
    "join-tokens": AttackCase(members.join_tokens, "a new member with a forged token", "supernode"),
    "cut-floors": AttackCase(members.cut_floors, "the cut at the end of time"),
    "globs": AttackCase(members.globs, "the lease lost; with 24 stars the host hung for ever"),
}
