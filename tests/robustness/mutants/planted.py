"""Faults to plant in the code under test, each with the test or simulator that must notice it.

A fault replaces one piece of text by another, so that it reads like a diff and needs no line numbers. If a piece is not
found exactly once, the code has changed: correct the piece here.
"""

from __future__ import annotations

from dataclasses import dataclass

REPLICATION = "services/supernode/src/stampede_rt_supernode/replication"
SUPERNODE = "services/supernode/src/stampede_rt_supernode"
HOST = "services/channel_host/src/stampede_rt_channel_host"
SEEDS_MAX = 100


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One fault. `noticed_by`: a simulator (see `hunt.SIMULATORS`), or a test that fails."""

    name: str
    file: str
    # Pairs of the present text and its replacement.
    edits: tuple[tuple[str, str], ...]
    noticed_by: str
    # Whether the test suite plants this fault. It plants only a few faults, because each takes seconds.
    quick: bool = False

    def plant(self, text: str) -> str:
        """The file with the fault. Raises LookupError if the code has changed."""
        for old, new in self.edits:
            if text.count(old) != 1:
                raise LookupError(
                    f"mutant {self.name} does not fit any more: {self.file} holds {text.count(old)} times (not once) "
                    f"{old!r}; mend the piece of text in {__name__}, so that the same fault is planted"
                )
            text = text.replace(old, new)
        return text


MUTANTS = (
    Mutant(
        name="acknowledge_before_the_disk",
        file=f"{REPLICATION}/raft_replica.py",
        edits=(
            (
                "        self._log.sync()\n        self._accept_requests()\n",
                "        self._network.release(self._node.transport.take_outbox())\n"
                "        self._log.sync()\n        self._accept_requests()\n",
            ),
        ),
        noticed_by="log",
        quick=True,
    ),
    Mutant(
        name="release_before_the_sync",
        file=f"{REPLICATION}/raft_replica.py",
        edits=(
            (
                "        self._log.sync()\n        self._release()\n",
                "        self._release()\n        self._log.sync()\n",
            ),
        ),
        noticed_by="log",
        quick=True,
    ),
    Mutant(
        name="second_vote_not_durable",
        file=f"{REPLICATION}/storage/raft_log.py",
        edits=(
            (
                "            self._term, self._voted_for = term, voted_for\n            self._dirty = True\n",
                "            self._dirty = self._dirty or term != self._term\n"
                "            self._term, self._voted_for = term, voted_for\n",
            ),
        ),
        noticed_by="log",
    ),
    Mutant(
        name="change_of_members_before_own_entry",
        file=f"{REPLICATION}/rules/membership.py",
        edits=(
            (
                "return self.can_confirm_reads() and self",
                "return self.is_leader and self",
            ),
        ),
        noticed_by="log",
    ),
    Mutant(
        name="ack_no_term",
        file=f"{REPLICATION}/rules/leader_role.py",
        edits=(
            (
                "if message.term != self.term or not self.is_leader:",
                "if not self.is_leader:",
            ),
        ),
        noticed_by="log",
    ),
    Mutant(
        name="commit_past_match",
        file=f"{REPLICATION}/rules/follower_role.py",
        edits=(
            (
                "self.raise_commit_index(min(message.commit_index, matched))",
                "self.raise_commit_index(min(message.commit_index, self.log.last_index))",
            ),
        ),
        noticed_by="log",
    ),
    Mutant(
        name="synchronous_off",
        file=f"{REPLICATION}/storage/sqlite_store.py",
        edits=(("PRAGMA synchronous=FULL", "PRAGMA synchronous=OFF"),),
        noticed_by="tests/unit/supernode/replication/storage/test_sqlite_store.py",
        quick=True,
    ),
    Mutant(
        name="replaced_stream_lives_on",
        file=f"{REPLICATION}/network/servicer.py",
        edits=(("            replaced.cancel()\n", "            pass\n"),),
        noticed_by="tests/unit/supernode/replication/network/test_peer_link.py",
    ),
    Mutant(
        name="links_queue_survives_a_break",
        file=f"{REPLICATION}/network/peer_link.py",
        edits=(("        self._queue.clear()\n        self.queued_bytes = 0\n", ""),),
        noticed_by="tests/unit/supernode/replication/network/test_peer_link.py",
        quick=True,
    ),
    Mutant(
        name="snapshot_not_checked",
        file=f"{REPLICATION}/storage/snapshot_receiver.py",
        edits=(("if hashlib.sha256(incoming.data).digest() != incoming.sha256:", "if False:"),),
        noticed_by="tests/unit/supernode/replication/rules/test_rules_closed_faults.py",
    ),
    Mutant(
        name="stored_snapshot_not_checked",
        file=f"{REPLICATION}/storage/sqlite_store.py",
        edits=(("if hashlib.sha256(record).digest() != trailer.sha256:", "if False:"),),
        noticed_by="tests/unit/supernode/replication/storage/test_sqlite_store.py",
    ),
    Mutant(
        name="dedup_window_cut",
        file=f"{SUPERNODE}/core/kept_answers.py",
        edits=(("MARKS_KEPT = 6\n", "MARKS_KEPT = 2\n"),),
        noticed_by="tests/unit/supernode/core/test_kept_answers.py",
    ),
    Mutant(
        name="host_counts_from_the_answer",
        file=f"{HOST}/cluster/registration.py",
        edits=(
            (
                '        response = await self._supernodes.call("RenewHostLease", request, timeout_s)\n',
                '        response = await self._supernodes.call("RenewHostLease", request, timeout_s)\n'
                "        sent = self._clock.boottime_nanos()\n",
            ),
        ),
        noticed_by="tests/unit/channel_host/cluster/test_registration.py",
    ),
    Mutant(
        name="lease_not_shorter_at_the_host",
        file=f"{HOST}/cluster/host_lease.py",
        edits=(("_FENCE_NUMERATOR, _FENCE_DENOMINATOR = 4, 5", "_FENCE_NUMERATOR, _FENCE_DENOMINATOR = 6, 5"),),
        noticed_by="directory",
    ),
    Mutant(
        name="renew_unconfirmed",
        file=f"{SUPERNODE}/servicers/lease_keeper.py",
        edits=(("        await self._submission.confirm(seconds=seconds)\n        self.check_leads(tenure)\n", ""),),
        noticed_by="directory",
    ),
    Mutant(
        name="expire_any_tenure",
        file=f"{SUPERNODE}/core/hosts/transitions.py",
        edits=(("not host.alive or operation.tenure != tenure:", "not host.alive:"),),
        noticed_by="directory",
    ),
    Mutant(
        name="late_registration_is_done",
        file=f"{SUPERNODE}/core/registration_epochs.py",
        edits=(("if highest is not None and highest.registration_epoch >= epoch:", "if False:"),),
        noticed_by="directory",
    ),
    Mutant(
        name="registration_with_the_same_epoch_is_done",
        file=f"{SUPERNODE}/core/registration_epochs.py",
        edits=(("highest.registration_epoch >= epoch:", "highest.registration_epoch > epoch:"),),
        noticed_by="directory",
    ),
    Mutant(
        name="level_not_checked",
        file=f"{SUPERNODE}/core/cluster/feature_levels.py",
        edits=(("    return needed <= cluster_level\n", "    return True\n"),),
        noticed_by="upgrading",
        quick=True,
    ),
    Mutant(
        name="level_not_checked_at_the_log",
        file=f"{REPLICATION}/library/node.py",
        edits=(("if self.state_machine.takes(command if commandType is not None else command[1:]):", "if True:"),),
        noticed_by="upgrading",
        quick=True,
    ),
    Mutant(
        name="level_raised_while_one_is_silent",
        file=f"{REPLICATION}/interface.py",
        edits=(
            ("self.highest_levels.get(member.member_id, 0) for", "self.highest_levels.get(member.member_id, 99) for"),
        ),
        noticed_by="upgrading",
    ),
    Mutant(
        name="no_permit_is_checked",
        file=f"{SUPERNODE}/core/moves/transitions.py",
        edits=(("or not owner.move_key:", "or owner.move_key:"),),
        noticed_by="tests/robustness/moves/test_hostile_hosts.py",
    ),
    Mutant(
        name="a_permit_for_all_epochs",
        file="services/runtime/src/stampede_rt_runtime/access/move_permits.py",
        edits=(('subject_id + epoch.to_bytes(8, "big") + to_host_id', "subject_id + to_host_id"),),
        noticed_by="tests/robustness/moves/test_hostile_hosts.py",
    ),
    Mutant(
        name="one_outcome_for_all_moves_of_an_entry",
        file=f"{HOST}/copies/moves/gathered_moves.py",
        edits=(("committed.get(one.channel_id) or", "committed.get(moves[-1].channel_id) or"),),
        noticed_by="tests/robustness/moves/test_moves_at_the_same_time.py",
    ),
    Mutant(
        name="puts_before_the_fallbacks_of_several_moves_are_released",
        file=f"{HOST}/copies/moves/incoming_moves.py",
        edits=(
            (
                "        await self._remove_fallback(hosted)",
                "        hosted.end_move()\n        await self._remove_fallback(hosted)",
            ),
        ),
        noticed_by="tests/robustness/moves/test_moves_at_the_same_time.py",
    ),
    Mutant(
        name="a_refused_move_of_a_drain_counts_as_moved",
        file=f"{HOST}/copies/moves/drain_requests.py",
        edits=(('            if outcome.HasField("error"):', "            if False:"),),
        noticed_by="tests/unit/channel_host/copies/moves/test_draining.py",
    ),
    Mutant(
        name="a_broken_stream_is_used_for_the_next_move",
        file=f"{HOST}/copies/moves/incoming_moves.py",
        edits=(("            if stream.is_new or feed.is_opened:\n", "            if True:\n"),),
        noticed_by="tests/robustness/moves/test_streams_of_moves.py",
    ),
    Mutant(
        name="an_idle_channel_is_handed_over_and_not_held",
        file=f"{HOST}/copies/moves/handoff_decision.py",
        edits=(
            ("            self._move.hold()\n", "            pass\n"),
            ("if not self._move.is_held or not self._is_fully_replicated():", "if not self._is_fully_replicated():"),
        ),
        noticed_by="drains",
    ),
    Mutant(
        name="a_broken_stream_of_a_drain_is_the_last_one",
        file=f"{HOST}/copies/moves/drain_requests.py",
        edits=(("            self._stream = None\n            writing", "            writing"),),
        noticed_by="drains",
    ),
    Mutant(
        name="a_host_answers_a_drain_once_for_each_channel",
        file=f"{HOST}/copies/moves/moves_of_drains.py",
        edits=(("        self._under_way.discard(channel_id)\n", ""),),
        noticed_by="drains",
    ),
    Mutant(
        name="a_release_at_any_epoch",
        file=f"{SUPERNODE}/core/moves/several.py",
        edits=(("(channel.host_id, channel.epoch) == (host_id, move.epoch)", "channel.host_id == host_id"),),
        noticed_by="tests/unit/supernode/core/moves/test_several.py",
    ),
    Mutant(
        name="nobody_allows_a_move",
        file=f"{HOST}/copies/moves/allowed_moves.py",
        edits=(("if until_s is None or until_s < self._clock_s():", "if until_s is not None and until_s < 0:"),),
        noticed_by="tests/robustness/moves/test_hostile_hosts.py",
    ),
    Mutant(
        name="break_of_a_lease_is_for_good",
        file=f"{HOST}/channels/owned_replicas.py",
        edits=(("        self.period = ServingPeriod()\n        self.wake_waits()", "        self.wake_waits()"),),
        noticed_by="takeovers",
    ),
    Mutant(
        name="lagging_replica_keeps_the_incarnation",
        file=f"{SUPERNODE}/core/takeover.py",
        edits=(("and (copy.kind is ReplicaKind.MOVE or copy.acknowledged)", ""),),
        noticed_by="takeovers",
    ),
    Mutant(
        name="flags_survive_a_loss",
        file=f"{SUPERNODE}/core/replicas/transitions.py",
        edits=(("in_sync=one.in_sync and one.acknowledged and continues", "in_sync=one.in_sync"),),
        noticed_by="tests/unit/supernode/core/replicas/test_transitions.py",
    ),
    Mutant(
        name="lag_is_not_checked",
        file=f"{HOST}/core/replication/in_sync.py",
        edits=(("all(now - one.caught_up <= LAG_NANOS_MAX for", "all(one for"),),
        noticed_by="takeovers",
    ),
    Mutant(
        name="flag_before_the_replica_has_everything",
        file=f"{HOST}/core/replication/in_sync.py",
        edits=(("and (self._may_lag or one.next_seq >= self._needed)", ""),),
        noticed_by="tests/property/test_replicas_in_sync.py",
    ),
    Mutant(
        name="replica_drops_its_items_with_its_flag",
        file=f"{HOST}/channels/owned_replicas.py",
        edits=(("        return has_dropped\n", "        return True\n"),),
        noticed_by="tests/unit/channel_host/channels/test_owned_replicas.py",
    ),
    Mutant(
        name="no_wait_for_a_replica_that_joins",
        file=f"{HOST}/core/replication/in_sync.py",
        edits=(("return self.state is not ReplicaState.OUT", "return self.state is ReplicaState.IN"),),
        noticed_by="takeovers",
    ),
    Mutant(
        name="a_replica_without_a_lease_counts",
        file=f"{HOST}/copies/copy_feed.py",
        edits=(("return not self._owner_facts or self._store.lease_held()", "return True"),),
        noticed_by="tests/robustness/takeovers/test_simulated_takeovers.py",
    ),
    Mutant(
        name="a_lookup_from_before_a_move_counts",
        file=f"{HOST}/channels/confirmed_records.py",
        edits=(("        if before == version():\n", "        if True:\n"),),
        noticed_by="tests/robustness/moves/test_late_answers.py",
    ),
    Mutant(
        name="a_replica_of_the_former_kind_stays",
        file=f"{HOST}/copies/replica_keeper.py",
        edits=(("if one.acknowledged is not self.waits", "if False"),),
        noticed_by="tests/robustness/takeovers/test_flags_of_replicas.py",
    ),
    Mutant(
        name="a_caller_removes_a_replica_in_sync",
        file=f"{SUPERNODE}/core/replicas/kinds.py",
        edits=(("elif is_left_to_owner(state.tables, operation):", "elif False:"),),
        noticed_by="tests/unit/supernode/core/replicas/test_transitions.py",
    ),
    Mutant(
        name="the_feed_of_a_removed_replica_counts",
        file=f"{HOST}/channels/owned_replicas.py",
        edits=(("self._feeds.pop(host_id, None)", "self._feeds.get(None)"),),
        noticed_by="tests/unit/channel_host/channels/test_owned_replicas.py",
    ),
    Mutant(
        name="a_message_is_acknowledged_by_its_host_alone",
        file=f"{HOST}/queues/replica_acks.py",
        edits=(('if replication is None or not ack.HasField("first_seq"):', "if True:"),),
        noticed_by="queues",
    ),
    Mutant(
        name="a_message_is_delivered_before_its_replicas_know",
        file=f"{HOST}/queues/hosted_queue.py",
        edits=(
            (
                "self.once_replicated(taker, partial(self._streams[taker].deliver, batch))",
                "self._streams[taker].deliver(batch)",
            ),
        ),
        noticed_by="queues",
    ),
    Mutant(
        name="a_settlement_is_confirmed_before_the_replicas_have_it",
        file=f"{HOST}/queues/take_stream.py",
        edits=(("hosted.once_replicated(self, partial(self._answer, results))", "self._answer(results)"),),
        noticed_by="queues",
    ),
    Mutant(
        name="a_dead_letter_goes_before_the_replicas_know",
        file=f"{HOST}/queues/dead_letters.py",
        edits=(("        await wait_for_replicas(hosted)\n", ""),),
        noticed_by="queues",
    ),
    Mutant(
        name="no_copy_of_a_moved_queue",
        file=f"{HOST}/queues/queue_store.py",
        edits=(('if error.reason == "MOVED" and hosted.moving is not None', "if False and hosted.moving is not None"),),
        noticed_by="tests/robustness/takeovers/test_queue_moves_at_each_step.py",
    ),
    Mutant(
        name="a_replica_continues_with_items_of_a_former_owner",
        file=f"{HOST}/copies/feed_stream.py",
        edits=(("place is not None and has_others_items(hosted, opening)", "False"),),
        noticed_by="tests/robustness/moves/test_crashes_with_replicas.py -k anew",
    ),
    Mutant(
        name="a_replica_keeps_an_item_that_the_owner_could_not_store",
        file=f"{HOST}/channels/puts/replicated_puts.py",
        edits=(("            self._replication.take_back()\n", "            pass\n"),),
        noticed_by="tests/unit/channel_host/copies/test_ahead_item_sender.py",
    ),
    Mutant(
        name="a_diverged_replica_of_a_channel_continues_after_a_break",
        file=f"{HOST}/channels/replication.py",
        edits=(
            (
                "        former = self._feeds",
                "        self.diverged_host_ids.discard(host_id)\n        former = self._feeds",
            ),
        ),
        noticed_by="tests/unit/channel_host/copies/test_ahead_item_sender.py",
    ),
    Mutant(
        name="a_replica_keeps_a_message_that_the_owner_could_not_store",
        file=f"{HOST}/queues/queue_replication.py",
        edits=(("if self._ahead is not None and not self.journal.has_made(self._ahead):", "if False:"),),
        noticed_by="tests/unit/channel_host/queues/test_replicated_queue.py",
    ),
    Mutant(
        name="a_diverged_replica_of_a_queue_continues",
        file=f"{HOST}/copies/queues/queue_feed.py",
        edits=(("if self._host_id in replication.diverged_host_ids:", "if False:"),),
        noticed_by="tests/unit/channel_host/copies/queues/test_queue_feed_ahead.py",
    ),
    Mutant(
        name="a_put_goes_ahead_although_it_is_delivered_in_the_same_step",
        file=f"{HOST}/queues/replicated_queue.py",
        edits=(("if not self.queue.waiting_takers:", "if True:"),),
        noticed_by="tests/property/test_queue_replicas.py",
    ),
    Mutant(
        name="a_queue_that_comes_back_trusts_its_replicas",
        file=f"{HOST}/queues/hosted_queue.py",
        edits=(("if moving is not None and was_at_other_owner and self.replication is not None:", "if False:"),),
        noticed_by="tests/unit/channel_host/queues/test_queue_replication.py",
    ),
    Mutant(
        name="a_copy_continues_with_steps_that_its_owner_lacks",
        file=f"{HOST}/copies/queues/queue_feed.py",
        edits=(("if place.owner_epoch < since and is_beyond:", "if False:"),),
        noticed_by="tests/unit/channel_host/copies/queues/test_queue_feed.py",
    ),
    Mutant(
        name="steps_of_another_incarnation",
        file=f"{HOST}/copies/queues/queue_feed.py",
        edits=(
            ("if not place.next_step or place.incarnation != hosted.queue.incarnation:", "if not place.next_step:"),
        ),
        noticed_by="tests/unit/channel_host/copies/queues/test_queue_feed.py",
    ),
    Mutant(
        name="an_inherited_queue_counts_as_replicated",
        file=f"{HOST}/queues/queue_copies.py",
        edits=(("is_replicated=False", "is_replicated=True"),),
        noticed_by="tests/unit/channel_host/queues/test_queue_copies.py",
    ),
    Mutant(
        name="the_pause_of_a_takeover_ends_leases",
        file=f"{HOST}/queues/queue_copies.py",
        edits=(("        copy.core.postpone(time.monotonic_ns() - copy.last_message_nanos)\n", ""),),
        noticed_by="tests/unit/channel_host/queues/test_queue_copies.py",
    ),
    Mutant(
        name="a_replica_comes_before_the_former_owner",
        file=f"{SUPERNODE}/core/takeover.py",
        edits=(("for one in former or copies)", "for one in copies)"),),
        noticed_by="tests/unit/supernode/core/moves/test_transitions.py",
    ),
    Mutant(
        name="numbers_of_the_former_owner_count",
        file=f"{SUPERNODE}/core/replicas/transitions.py",
        edits=(("epoch=after.epoch, change_number=0)", "epoch=after.epoch)"),),
        noticed_by="tests/unit/supernode/core/replicas/test_transitions_of_queues.py",
    ),
    Mutant(
        name="the_second_move_of_a_queue_counts",
        file=f"{SUPERNODE}/core/moves/transitions.py",
        edits=(("    check_queue_epoch(queue, operation.epoch)\n    _check_registration", "    _check_registration"),),
        noticed_by="tests/unit/supernode/core/replicas/test_transitions_of_queues.py",
    ),
    Mutant(
        name="an_owner_again_trusts_its_replicas",
        file=f"{HOST}/core/replication/in_sync.py",
        edits=(("        self._replicas.clear()\n        self._is_known = False\n", ""),),
        noticed_by="tests/unit/channel_host/queues/test_queue_replication.py",
    ),
    Mutant(
        name="items_of_another_reader",
        file="client/src/stampede_rt/multicast/encryption.py",
        edits=(
            ("except InvalidSignature:\n            return None", "except InvalidSignature:\n            return bare"),
        ),
        noticed_by="tests/property/test_multicast_against_stream.py",
    ),
    Mutant(
        name="a_message_twice",
        file="client/src/stampede_rt/multicast/seq_merge.py",
        edits=(("[item for item in one.items if item.seq >= self.next_seq]", "one.items"),),
        noticed_by="tests/unit/client/multicast/test_merging.py",
    ),
)
