"""All attacks, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tests.benchmarks.attacks import memory, neighbours, quotas, readers, without_credential
from tests.benchmarks.attacks.ground import Attack

Part = Literal["host", "supernode"]


@dataclass(frozen=True)
class Case:
    """One attack; `watched` is the part of the cluster whose memory is told."""

    attack: Attack
    watched: Part = "host"

    @property
    def text(self) -> str:
        """What is done, in a sentence."""
        return " ".join((self.attack.__doc__ or "").split()).rstrip(".")


CASES: dict[str, Case] = {
    "health-headers": Case(without_credential.health_headers),
    "unfinished-health": Case(without_credential.unfinished_health),
    "resets": Case(without_credential.resets),
    "idle-connections": Case(without_credential.idle_connections),
    "malformed": Case(without_credential.malformed),
    "unfinished-puts": Case(without_credential.unfinished_puts),
    "unfinished-messages": Case(without_credential.unfinished_messages),
    "health-watches": Case(neighbours.health_watches),
    "repeated-fields": Case(memory.repeated_fields),
    "attributes": Case(memory.attributes),
    "refused-runs": Case(memory.refused_runs),
    "late-clock": Case(memory.late_clock),
    "waiting-puts": Case(memory.waiting_puts),
    "waiting-enqueues": Case(memory.waiting_enqueues),
    "silent-subscriptions": Case(memory.silent_subscriptions),
    "silent-gets": Case(memory.silent_gets),
    "silent-takers": Case(memory.silent_takers),
    "silent-cuts": Case(neighbours.silent_cuts),
    "silent-watches": Case(neighbours.silent_watches, "supernode"),
    "unknown-fields": Case(memory.unknown_fields),
    "large-gets": Case(neighbours.large_gets),
    "many-subscriptions": Case(neighbours.many_subscriptions),
    "new-channels": Case(neighbours.new_channels, "supernode"),
    "many-streams": Case(quotas.many_streams),
    "blocked-gets": Case(quotas.blocked_gets),
    "busy-puts": Case(quotas.busy_puts),
    "single-calls": Case(quotas.single_calls),
    "held-bytes": Case(quotas.held_bytes),
    "many-cuts": Case(readers.many_cuts),
    "many-matches": Case(readers.many_matches),
    "busy-takes": Case(readers.busy_takes),
}
