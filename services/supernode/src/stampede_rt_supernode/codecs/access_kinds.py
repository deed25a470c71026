"""Converts commands about the rules of access, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_runtime.access.messages import rule_from, rule_message
from stampede_rt_supernode.codecs.kind_codec import KindCodec
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

CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="create_token_key",
        outcome="token_key_created",
        operation=CreateTokenKey,
        result=TokenKeyCreated,
        write=lambda one: pb.CreateTokenKeyCommand(new_token_key=one.new_token_key),
        read=lambda message: CreateTokenKey(new_token_key=message.new_token_key),
        write_result=lambda one: pb.TokenKeyCreatedResult(version=one.version),
        read_result=lambda message: TokenKeyCreated(version=message.version),
    ),
    KindCodec(
        kind="revoke_credential",
        outcome="credential_revoked",
        operation=RevokeCredential,
        result=CredentialRevoked,
        write=lambda one: pb.RevokeCredentialCommand(serial=one.serial),
        read=lambda message: RevokeCredential(serial=message.serial),
        write_result=lambda one: pb.CredentialRevokedResult(revoked=one.revoked, version=one.version),
        read_result=lambda message: CredentialRevoked(revoked=message.revoked, version=message.version),
    ),
    KindCodec(
        kind="add_access_rule",
        outcome="access_rule_added",
        operation=AddAccessRule,
        result=AccessRuleAdded,
        write=lambda one: pb.AddAccessRuleCommand(rule=rule_message(one.rule)),
        read=lambda message: AddAccessRule(rule=rule_from(message.rule)),
        write_result=lambda one: pb.AccessRuleAddedResult(added=one.added, version=one.version),
        read_result=lambda message: AccessRuleAdded(added=message.added, version=message.version),
    ),
    KindCodec(
        kind="remove_access_rule",
        outcome="access_rule_removed",
        operation=RemoveAccessRule,
        result=AccessRuleRemoved,
        write=lambda one: pb.RemoveAccessRuleCommand(rule=rule_message(one.rule)),
        read=lambda message: RemoveAccessRule(rule=rule_from(message.rule)),
        write_result=lambda one: pb.AccessRuleRemovedResult(removed=one.removed, version=one.version),
        read_result=lambda message: AccessRuleRemoved(removed=message.removed, version=message.version),
    ),
)
