"""Adds and removes members, one at a time: the leader's steps.

An addition has three steps. The leader sends the newcomer the log until a round of catching up has taken less than the
shortest election timeout. Then the leader puts a configuration with the newcomer into the log. That configuration takes
effect immediately. The addition is done when the configuration is committed (Ongaro's dissertation, section 4.2). A
removal needs no first step. A leader does not remove itself: it hands over, and the caller asks its successor for the
removal.
"""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import (
    ChangeRefused,
    ChangeUnderWay,
    LogUnavailable,
    NotLeading,
    OutcomeUnknown,
    ReleaseOutdated,
    too_old,
)
from stampede_rt_supernode.replication.rules.leadership_transfer import HandOver, LeadershipTransfer
from stampede_rt_supernode.replication.rules.member_change import (
    ChangeOutcome,
    CommittingChange,
    MemberAddition,
    MemberChange,
    refusal_of_member,
)
from stampede_rt_supernode.replication.rules.membership import Membership

# The leader gives up a newcomer that has made no progress for this time, so that other newcomers can join.
STALLED_SECONDS = 30.0
# The leader replaces a newcomer that has made no progress for this time by another newcomer that asks. If the leader
# has given a newcomer up before, it replaces this newcomer without delay, until the newcomer makes progress.
REPLACED_AFTER_SECONDS = 5.0
# The leader gives up a newcomer that has not caught up in this time, even if it makes progress. At its next try this
# leader replaces such a newcomer as soon as another one asks.
JOIN_SECONDS_MAX = 600.0


class MemberChanges:
    """All changes of the members that one replica makes. Tick thread only.

    At most one configuration is uncommitted, and at most one newcomer catches up. A removal does not wait for the
    newcomer. Invariant: an uncommitted configuration and a newcomer exist only while this node leads.
    """

    def __init__(
        self,
        node: Membership,
        clock: Callable[[], float],
        finish: Callable[[Callable[[], None]], None],
        *,
        round_seconds: float,
        alive_seconds: float,
    ) -> None:
        """A newcomer has caught up when a round of catching up has taken `round_seconds` at most.

        A member that has answered the leader within `alive_seconds` counts as alive. `finish(call)` makes the call as
        soon as the changes of this step are durable.
        """
        self._node = node
        self._clock = clock
        self._finish_later = finish
        self._round_seconds = round_seconds
        self._alive_seconds = alive_seconds
        self._addition: MemberAddition | None = None
        # the id of the newcomer that was given up last for lack of progress; empty as soon as it makes progress
        self._given_up_id = ""
        # the id of the newcomer that took too long; empty as soon as another newcomer begins to catch up
        self._slow_id = ""
        self._committing: CommittingChange | None = None
        self._transfer = LeadershipTransfer(node, clock, finish, alive_seconds=alive_seconds)

    @property
    def hands_over(self) -> bool:
        """Whether new commands should wait for the next leader."""
        return self._transfer.under_way

    @property
    def is_idle(self) -> bool:
        """Whether no addition, removal or hand-over is under way."""
        return self._addition is None and self._committing is None and not self._transfer.under_way

    def add(self, change: MemberChange) -> None:
        """Begin a change, or refuse it. If the same change is under way already, `change` ends with it."""
        if not self._node.is_leader:
            self._finish([change], NotLeading("this replica does not lead"))
        elif self._joins_same_change(change):
            return
        elif self._committing is not None or not self._node.may_change_members():
            self._finish(
                [change], ChangeUnderWay("another change of the members is under way, or the leader is new; try again")
            )
        elif change.is_removal:
            self._remove(change)
        elif self._addition is not None and not self._may_be_replaced(self._addition):
            name = self._addition.member.member_id
            self._finish([change], ChangeUnderWay(f"{name} is joining, and others wait until it has joined"))
        else:
            if self._addition is not None:
                self._replace(self._addition, change.member.member_id)
            self._begin_addition(change)

    def hand_over(self, request: HandOver) -> None:
        """Begin to look for a successor."""
        self._transfer.begin(request)

    def advance(self) -> None:
        """Take the next step of all changes and of the hand-over that are under way."""
        if not self._leads_on():
            self._end(NotLeading("this replica no longer leads"))
            return
        if self._addition is not None:
            self._catch_up(self._addition)
        if self._committing is not None and self._node.last_applied >= self._committing.log_index:
            done, self._committing = self._committing, None
            self._finish(done.callers, done.log_index)
        self._transfer.advance()

    def _leads_on(self) -> bool:
        """Whether this node leads, and has led without a break since the present change began."""
        node, addition, committing = self._node, self._addition, self._committing
        return bool(
            node.is_leader
            and (addition is None or node.learner == addition.member)
            and (committing is None or node.term == committing.term)
        )

    def close(self) -> None:
        """End all waiting calls."""
        self._end(LogUnavailable("this replica is closing"))

    # -- the steps of a change -----------------------------------------------------------------------------------

    def _joins_same_change(self, change: MemberChange) -> bool:
        """If the same change is under way, let `change` end with it. Returns whether it is under way."""
        addition, committing = self._addition, self._committing
        if addition is not None and not change.is_removal and addition.member == change.member:
            addition.callers.append(change)
            return True
        if committing is not None and committing.member_id == change.member.member_id:
            is_member = self._node.configuration().find(committing.member_id) is not None
            if is_member != change.is_removal:
                committing.callers.append(change)
                return True
        return False

    def _begin_addition(self, change: MemberChange) -> None:
        """Begin to send the log to a newcomer, unless it is a member already, or may not join."""
        configuration, member = self._node.configuration(), change.member
        if configuration.find(member.member_id) == member:
            self._finish([change], self._node.last_applied)
            return
        refusal = refusal_of_member(configuration, member, change.ticket)
        if refusal is not None:
            self._finish([change], refusal)
            return
        self._node.set_learner(member)
        now = self._clock()
        if member.member_id != self._slow_id:
            self._slow_id = ""
        self._addition = MemberAddition(member, [change], self._node.log.last_index, now, now, now)

    def _catch_up(self, addition: MemberAddition) -> None:
        now, held = self._clock(), self._node.held_by(addition.member.member_id)
        progress = (held, self._node.keeper.sent_bytes(addition.member.member_id))
        if progress != addition.progress:
            addition.progress, addition.progress_at = progress, now
            if self._given_up_id == addition.member.member_id:
                self._given_up_id = ""
        elif now - addition.progress_at > STALLED_SECONDS:
            self._give_up(addition)
            return
        if now - addition.began > JOIN_SECONDS_MAX:
            self._give_up_slow(addition)
            return
        if held < addition.round_end or self._committing is not None or not self._is_alive(addition):
            return
        if now - addition.round_began > self._round_seconds:
            addition.round_end, addition.round_began = self._node.log.last_index, now
            return
        if self._node.may_change_members():
            if self._is_too_old(addition):
                return
            self._addition = None
            configuration = self._node.configuration().with_member(addition.member, addition.callers[0].ticket)
            # First make the newcomer a voter, and then end its time as a learner. So this node keeps the position that
            # the newcomer has acknowledged.
            self._commit(addition.member.member_id, configuration, addition)
            self._node.set_learner(None)

    def _is_alive(self, addition: MemberAddition) -> bool:
        """Whether the newcomer still answers. As a voter that is down, it could cost the cluster its majority."""
        return self._node.has_answered(addition.member.member_id, within_seconds=self._alive_seconds)

    def _is_too_old(self, addition: MemberAddition) -> bool:
        """Refuse the newcomer if its release does not know the cluster's feature level. Returns True if it does not."""
        newcomer, needed = addition.member.member_id, self._node.level_to_join()
        highest = self._node.known_levels().get(newcomer, 0)
        if highest >= needed:
            return False
        self._addition = None
        self._node.set_learner(None)
        self._finish(addition.callers, ReleaseOutdated(too_old(newcomer, highest, needed)))
        return True

    def _may_be_replaced(self, addition: MemberAddition) -> bool:
        """Whether a newcomer is stuck, or too slow, so that another newcomer may replace it."""
        stuck_seconds = self._clock() - addition.progress_at
        return stuck_seconds > REPLACED_AFTER_SECONDS or addition.member.member_id in (self._given_up_id, self._slow_id)

    def _replace(self, addition: MemberAddition, other_id: str) -> None:
        """End an addition, so that another newcomer replaces it."""
        if self._clock() - addition.progress_at > REPLACED_AFTER_SECONDS:
            self._give_up(addition)
            return
        text = (
            f"{other_id} joins instead of {addition.member.member_id} at {addition.member.address}, which did not "
            "catch up with the log at its last try; the replaced supernode may try again"
        )
        self._end_addition(addition, text)

    def _give_up(self, addition: MemberAddition) -> None:
        """Give up a newcomer without progress. It may try again, because its token is not used up."""
        self._given_up_id = addition.member.member_id
        text = (
            f"{addition.member.member_id} at {addition.member.address} took nothing of the log for "
            f"{self._clock() - addition.progress_at:.0f} s; make sure that it runs, and that this address leads to it"
        )
        self._end_addition(addition, text)

    def _give_up_slow(self, addition: MemberAddition) -> None:
        """Give up a newcomer that makes progress, but too little."""
        self._slow_id = addition.member.member_id
        text = (
            f"{addition.member.member_id} at {addition.member.address} has not caught up with the log within "
            f"{JOIN_SECONDS_MAX:.0f} s; give it a faster link or disk, or let it join while less is written"
        )
        self._end_addition(addition, text)

    def _end_addition(self, addition: MemberAddition, text: str) -> None:
        self._addition = None
        self._node.set_learner(None)
        self._finish(addition.callers, ChangeUnderWay(text))

    def _remove(self, change: MemberChange) -> None:
        configuration, member_id = self._node.configuration(), change.member.member_id
        if configuration.find(member_id) is None:
            self._finish([change], self._node.last_applied)
        elif len(configuration.members) == 1:
            self._finish([change], ChangeRefused(f"{member_id} is the last member; stop it instead of removing it"))
        elif not self._majority_without(member_id):
            self._finish([change], self._no_majority_without(member_id))
        elif member_id == self._node.self_member.member_id:
            self.hand_over(HandOver(lambda has_left_lead: change.done(_after_hand_over(has_left_lead))))
        else:
            self._commit(member_id, configuration.without(member_id), change)

    def _majority_without(self, member_id: str) -> bool:
        alive = self._node.alive_voters(within_seconds=self._alive_seconds) | {self._node.self_member.member_id}
        return 2 * len(alive - {member_id}) > len(self._node.configuration().members) - 1

    def _no_majority_without(self, member_id: str) -> ChangeOutcome:
        if not self._node.has_led_for(self._alive_seconds):
            return ChangeUnderWay(
                f"{self._node.self_member.member_id} has led for too short a time to know whether a majority of the "
                f"members is alive without {member_id}; try again"
            )
        return ChangeRefused(
            f"without {member_id} no majority of the members would be alive; "
            "start or replace the others that are down first"
        )

    def _commit(self, member_id: str, configuration: Configuration, source: MemberAddition | MemberChange) -> None:
        callers = source.callers if isinstance(source, MemberAddition) else [source]
        log_index = self._node.append_configuration(configuration)
        self._committing = CommittingChange(member_id, log_index, self._node.term, callers)

    # -- outcomes ------------------------------------------------------------------------------------------------

    def _end(self, outcome: NotLeading | LogUnavailable) -> None:
        addition, self._addition = self._addition, None
        committing, self._committing = self._committing, None
        if addition is not None:
            self._finish(addition.callers, outcome)
        if committing is not None:
            self._finish(committing.callers, self._fate_of(committing))
        self._transfer.end()

    def _fate_of(self, committing: CommittingChange) -> ChangeOutcome:
        applied = self._node.last_applied >= committing.log_index
        if applied and self._node.term_at(committing.log_index) == committing.term:
            return committing.log_index
        return OutcomeUnknown("the leader changed during the change; list the members (stampede supernode status)")

    def _finish(self, callers: list[MemberChange], outcome: ChangeOutcome) -> None:
        for caller in callers:
            self._finish_later(lambda caller=caller: caller.done(outcome))  # type: ignore[misc]


def _after_hand_over(has_left_lead: bool) -> ChangeOutcome:
    if has_left_lead:
        return NotLeading("this replica was the leader, and has handed over: ask the new one")
    return LogUnavailable("this replica leads, and no other member could take over; try again")
