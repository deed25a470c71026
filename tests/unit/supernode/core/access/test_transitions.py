"""Rules of access and the key of client tokens in the directory."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.access.rules import RULES_MAX, AccessKind, AccessRule, AccessRules, AccessVerb
from stampede_rt_runtime.access.tokens import public_key
from stampede_rt_supernode.codecs.command_codec import decode_result, encode_command
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.access.commands import (
    AccessRuleAdded,
    AccessRuleRemoved,
    AddAccessRule,
    CreateTokenKey,
    CredentialRevoked,
    RemoveAccessRule,
    RevokeCredential,
    TokenKeyCreated,
)
from stampede_rt_supernode.core.access.effects import AccessEffect, effects_on, with_rule, without_rule
from stampede_rt_supernode.core.access.queries import access_state
from stampede_rt_supernode.core.access.transitions import REVOKED_MAX
from stampede_rt_supernode.core.cluster.commands import BeginTenure, RaiseFeatureLevel
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation, Result
from stampede_rt_supernode.core.peers.commands import PeerRegistered, RegisterPeer
from stampede_rt_supernode.core.records import AccessChange
from stampede_rt_supernode.replica import DirectoryReplica
from tests.support.supernode.operations import Log, begin_tenure, id_of, open_channel, register, register_peer

PUT = AccessRule("cam-*", (AccessVerb.PUT,), AccessKind.CHANNEL, "video/*")
DENY = AccessRule("*", (), None, "secret/*", deny=True)


def changes(log: Log) -> list[int]:
    ring = log.directory.tables.changes
    page = ring.read(0, 100)
    assert page is not None
    return [one.index for one in page.changes if isinstance(one.subject, AccessChange)]


def test_rules_are_a_set_and_each_change_raises_the_version() -> None:
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


def test_the_number_of_access_rules_has_a_limit() -> None:
    log = Log()
    for number in range(RULES_MAX):
        log.apply(AddAccessRule(rule=replace(PUT, who=str(number))))
    refused = log.apply(AddAccessRule(rule=PUT))
    assert isinstance(refused, RefusedOperation)
    assert isinstance(refused.error(), InvalidArgument)
    assert len(log.directory.access.rules.rules) == RULES_MAX


def test_the_first_key_is_kept_and_the_state_does_not_show_the_signing_key() -> None:
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
    repeated = begin_tenure(9)
    assert isinstance(repeated, BeginTenure)
    log.apply(replace(repeated, founded_anew=True, new_cluster_id="other"))
    assert log.directory.access.token_key == b""
    assert log.directory.access.rules.rules == (PUT,)


def test_below_the_feature_level_of_rules_the_directory_stores_neither_rules_nor_owners() -> None:
    replica = DirectoryReplica()
    commands: list[Operation] = [begin_tenure(1), register(1), AddAccessRule(rule=PUT), owned_peer("robot")]
    results = [applied(replica, index, one) for index, one in enumerate(commands, start=1)]
    assert isinstance(results[2], RefusedOperation)
    assert results[2].reason == "VERSION_MISMATCH"
    assert isinstance(results[3], PeerRegistered)
    assert results[3].peer.owner is None
    applied(replica, 5, RaiseFeatureLevel(feature_level=2))
    assert isinstance(applied(replica, 6, AddAccessRule(rule=PUT)), AccessRuleAdded)
    repeated = applied(replica, 7, replace(owned_peer("other"), peer_id=id_of(8), new_mailbox_id=id_of(9)))
    assert isinstance(repeated, PeerRegistered)
    assert repeated.peer.owner == "cam"
    assert repeated.mailbox is not None
    assert (repeated.mailbox.mailbox_owner, repeated.mailbox.mailbox_peer_name) == ("cam", "other")


def applied(replica: DirectoryReplica, index: int, operation: Operation) -> Result:
    command = Command(op_id=id_of(1000 + index), time_unix_nano=0, operation=operation)
    return decode_result(replica.apply(index, encode_command(command)))


def owned_peer(name: str) -> RegisterPeer:
    return replace(register_peer(7, name), owner="cam")


def test_no_other_client_takes_the_name_of_a_peer_with_any_proof() -> None:
    log = Log()
    log.apply(RaiseFeatureLevel(feature_level=2))
    log.apply(register(1))
    log.apply(replace(register_peer(7, "robot", proof=5), owner="cam"))
    thief = log.apply(replace(register_peer(7, "robot", proof=5, boot=9), owner="thief"))
    assert isinstance(thief, RefusedOperation)
    assert thief.reason == "PERMISSION_DENIED"
    for owner in ("cam", ""):
        assert isinstance(log.apply(replace(register_peer(7, "robot", proof=5, boot=9), owner=owner)), PeerRegistered)


def test_the_effects_of_a_rule_are_reported_for_each_existing_thing() -> None:
    log = Log()
    log.apply(register(1))
    for name in ("video/1", "video/2", "audio"):
        log.apply(open_channel(name))
    other = AccessRule("*", (AccessVerb.LIST,), None, "*")
    before = AccessRules([other])
    effects = effects_on(log.directory.tables, before, with_rule(before, PUT), PUT)
    assert effects == [
        AccessEffect(AccessVerb.PUT, AccessKind.CHANNEL, name, allowed=True) for name in ("video/1", "video/2")
    ]
    assert effects_on(log.directory.tables, before, without_rule(before, PUT), PUT) == []


def test_revoked_certificates_are_kept_in_snapshots_and_are_bounded() -> None:
    log = Log()
    first = log.apply(RevokeCredential(serial="a1"))
    assert isinstance(first, CredentialRevoked)
    assert first.revoked
    assert log.apply(RevokeCredential(serial="a1")) == CredentialRevoked(revoked=False, version=first.version)
    assert access_state(decode_snapshot(encode_snapshot(log.directory))).revoked_serials == {"a1"}
    for number in range(1, REVOKED_MAX):
        log.apply(RevokeCredential(serial=f"{number:x}a1"))
    refused = log.apply(RevokeCredential(serial="b2"))
    assert isinstance(refused, RefusedOperation)
    assert len(log.directory.access.revoked_serials) == REVOKED_MAX
