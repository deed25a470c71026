"""Rules of access and the key of client tokens in the directory."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.access.rules import RULES_MAX, AccessKind, AccessRule, AccessVerb
from stampede_rt_runtime.access.tokens import public_key
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.access.commands import (
    AccessRuleAdded,
    AccessRuleRemoved,
    AddAccessRule,
    CreateTokenKey,
    RemoveAccessRule,
    TokenKeyCreated,
)
from stampede_rt_supernode.core.access.queries import access_state
from stampede_rt_supernode.core.cluster.commands import BeginTenure
from stampede_rt_supernode.core.commands import Refused
from stampede_rt_supernode.core.records import AccessChange
from tests.support.supernode.operations import Log, begin_tenure

PUT = AccessRule("cam-*", (AccessVerb.PUT,), AccessKind.CHANNEL, "video/*")
DENY = AccessRule("*", (), None, "secret/*", deny=True)


def changes(log: Log) -> list[int]:
    ring = log.directory.tables.changes
    page = ring.read(0, 100)
    assert page is not None
    return [one.index for one in page.changes if isinstance(one.subject, AccessChange)]


def test_rules_are_a_set_and_each_change_is_a_version() -> None:
    log = Log()
    added = log.apply(AddAccessRule(rule=PUT))
    assert isinstance(added, AccessRuleAdded)
    assert (added.added, added.version) == (True, log.directory.applied_index)
    assert log.apply(AddAccessRule(rule=PUT)) == AccessRuleAdded(added=False, version=added.version)
    log.apply(AddAccessRule(rule=DENY))
    assert access_state(log.directory).rules.rules == (PUT, DENY)
    removed = log.apply(RemoveAccessRule(rule=PUT))
    assert isinstance(removed, AccessRuleRemoved)
    assert log.apply(RemoveAccessRule(rule=PUT)) == AccessRuleRemoved(removed=False, version=removed.version)
    assert access_state(log.directory).rules.rules == (DENY,)
    assert len(changes(log)) == 3


def test_there_are_so_many_rules_and_no_more() -> None:
    log = Log()
    for number in range(RULES_MAX):
        log.apply(AddAccessRule(rule=replace(PUT, who=str(number))))
    refused = log.apply(AddAccessRule(rule=PUT))
    assert isinstance(refused, Refused)
    assert isinstance(refused.error(), InvalidArgument)
    assert len(log.directory.access.rules.rules) == RULES_MAX


def test_the_first_key_stays_and_nobody_is_told_what_signs() -> None:
    log = Log()
    first = log.apply(CreateTokenKey(new_token_key=b"1" * 32))
    assert isinstance(first, TokenKeyCreated)
    assert log.apply(CreateTokenKey(new_token_key=b"2" * 32)) == first
    assert access_state(log.directory).token_keys == (public_key(b"1" * 32),)
    assert "1111" not in repr(log.directory.access)


def test_a_snapshot_holds_rules_and_key() -> None:
    log = Log()
    for operation in (AddAccessRule(rule=PUT), AddAccessRule(rule=DENY), CreateTokenKey(new_token_key=b"1" * 32)):
        log.apply(operation)
    restored = decode_snapshot(encode_snapshot(log.directory))
    assert access_state(restored) == replace(access_state(log.directory), rules=restored.access.rules)
    assert restored.access.rules.rules == (PUT, DENY)
    assert restored.access.token_key == b"1" * 32


def test_a_cluster_gets_its_key_with_its_first_leader_if_all_members_know_of_keys() -> None:
    for level, key in ((1, b""), (2, b"1" * 32)):
        log = Log(founded=False)
        log.apply(replace(begin_tenure(1), new_feature_level=level, new_token_key=b"1" * 32))
        log.apply(replace(begin_tenure(2), new_token_key=b"2" * 32))
        assert log.directory.access.token_key == key
        assert len(changes(log)) == level - 1


def test_a_restored_cluster_keeps_its_rules_and_signs_with_a_key_of_its_own() -> None:
    log = Log()
    log.apply(AddAccessRule(rule=PUT))
    log.apply(CreateTokenKey(new_token_key=b"1" * 32))
    again = begin_tenure(9)
    assert isinstance(again, BeginTenure)
    log.apply(replace(again, founded_anew=True, new_cluster_id="other"))
    assert log.directory.access.token_key == b""
    assert log.directory.access.rules.rules == (PUT,)
