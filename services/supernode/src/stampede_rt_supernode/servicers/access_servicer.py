"""Serves AccessService (proto/stampede_rt/v1/access_service.proto). Each method checks the request, asks the core or
the log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import NamedTuple

from stampede_rt.v1 import access_service_pb2 as pb
from stampede_rt.v1 import access_service_pb2_grpc
from stampede_rt_runtime.access.control import audit_change
from stampede_rt_runtime.access.messages import (
    KINDS,
    VERBS,
    kind_from,
    rule_from,
    rule_message,
    state_message,
    verb_from,
)
from stampede_rt_runtime.access.rules import AccessRule, AccessRules, check_rule
from stampede_rt_runtime.access.tokens import KEY_BYTES, VALID_NANOS_DEFAULT, TokenClaims, check_claims, make_token
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.core.access import commands
from stampede_rt_supernode.core.access.effects import (
    AccessEffect,
    client_named,
    effects_on,
    with_rule,
    without_rule,
)
from stampede_rt_supernode.core.access.queries import access_state
from stampede_rt_supernode.core.command_table import check_operation
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.validation import check_id
from stampede_rt_supernode.servicers.calls import DirectoryCalls

SERIAL_BYTES = 8


class _Change(NamedTuple):
    """The rules before and after a planned change, and the effects of the change.

    `version` is the log position of the last change of the AccessTable before the planned change.
    """

    version: int
    before: AccessRules
    after: AccessRules
    effects: list[pb.AccessEffect]


class AccessServicer(access_service_pb2_grpc.AccessServiceServicer):
    """One supernode's answers about rights."""

    def __init__(self, calls: DirectoryCalls, time_unix_nano: Callable[[], int]) -> None:
        self._calls = calls
        self._time_unix_nano = time_unix_nano

    @errors_as_status
    async def CreateClientToken(
        self, request: pb.CreateClientTokenRequest, context: Context
    ) -> pb.CreateClientTokenResponse:
        """Issues a token. If the cluster is older than client tokens and has no key for them, creates the key first."""
        check_id(request.request_id, "request_id")
        valid_nanos = request.valid_nanos if request.HasField("valid_nanos") else VALID_NANOS_DEFAULT
        roles = check_claims(request.name, request.roles, valid_nanos)
        access = await self._calls.read(context, lambda directory: directory.access)
        if not access.token_key:
            operation = commands.CreateTokenKey(new_token_key=secrets.token_bytes(KEY_BYTES))
            await self._calls.submit(context, operation, commands.TokenKeyCreated, request.request_id)
            access = await self._calls.read(context, lambda directory: directory.access)
        claims = TokenClaims(
            cluster_id=await self._calls.read(context, lambda directory: directory.cluster_id, stale_ok=True),
            name=request.name,
            roles=roles,
            serial=secrets.token_hex(SERIAL_BYTES),
            ends_unix_nano=self._time_unix_nano() + valid_nanos,
        )
        audit_change("issue token", f"{claims.name} {' '.join(roles)} serial {claims.serial}")
        return pb.CreateClientTokenResponse(
            token=make_token(access.token_key, claims),
            serial=claims.serial,
            valid_until_unix_nano=claims.ends_unix_nano,
            version=access.version,
        )

    @errors_as_status
    async def AddAccessRule(self, request: pb.AddAccessRuleRequest, context: Context) -> pb.AddAccessRuleResponse:
        """With dry_run, adds nothing, and answers with the effects that the rule would have."""
        operation = commands.AddAccessRule(rule=rule_from(request.rule))
        change = await self._change(context, operation, lambda rules: with_rule(rules, operation.rule))
        added, version = change.after is not change.before, change.version
        if not request.dry_run:
            done = await self._calls.submit(context, operation, commands.AccessRuleAdded, request.request_id)
            added, version = done.added, done.version
            audit_change("add rule", str(operation.rule), done=added)
        return pb.AddAccessRuleResponse(
            added=added, rules=len(change.after.rules), effects=change.effects, version=version
        )

    @errors_as_status
    async def RemoveAccessRule(
        self, request: pb.RemoveAccessRuleRequest, context: Context
    ) -> pb.RemoveAccessRuleResponse:
        """With dry_run, removes nothing, and answers with the effects that the removal would have."""
        operation = commands.RemoveAccessRule(rule=rule_from(request.rule))
        change = await self._change(context, operation, lambda rules: without_rule(rules, operation.rule))
        removed, version = len(change.after.rules) < len(change.before.rules), change.version
        if not request.dry_run:
            done = await self._calls.submit(context, operation, commands.AccessRuleRemoved, request.request_id)
            removed, version = done.removed, done.version
            audit_change("remove rule", str(operation.rule), done=removed)
        return pb.RemoveAccessRuleResponse(
            removed=removed, rules=len(change.after.rules), effects=change.effects, version=version
        )

    async def _change(
        self,
        context: Context,
        operation: commands.AddAccessRule | commands.RemoveAccessRule,
        change: Callable[[AccessRules], AccessRules],
    ) -> _Change:
        """The effects that a change of the present rules would have. Raises InvalidArgument for an invalid rule."""
        check_operation(operation)

        def judge(directory: Directory) -> _Change:
            before = directory.access.rules
            after = change(before)
            effects = effects_on(directory.tables, before, after, operation.rule)
            return _Change(directory.access.version, before, after, [_effect_message(effect) for effect in effects])

        return await self._calls.read(context, judge)

    @errors_as_status
    async def ListAccessRules(self, request: pb.ListAccessRulesRequest, context: Context) -> pb.ListAccessRulesResponse:
        access = await self._calls.read(context, lambda directory: directory.access, stale_ok=request.stale_ok)
        return pb.ListAccessRulesResponse(rules=map(rule_message, access.rules.rules), version=access.version)

    @errors_as_status
    async def CheckAccess(self, request: pb.CheckAccessRequest, context: Context) -> pb.CheckAccessResponse:
        """Answers whether a client with the name `who` has the right `verb` on the named thing."""
        verb, kind = verb_from(request.verb), kind_from(request.kind)
        check_rule(AccessRule(request.who, (verb,), kind, request.name))
        rules = await self._calls.read(context, lambda directory: directory.access.rules)
        ruling = rules.judge(client_named(request.who), verb, kind, request.name)
        return pb.CheckAccessResponse(
            allowed=ruling.allowed,
            rule=None if ruling.rule is None else rule_message(ruling.rule),
            rules=len(rules.rules),
        )

    @errors_as_status
    async def RevokeCredential(
        self, request: pb.RevokeCredentialRequest, context: Context
    ) -> pb.RevokeCredentialResponse:
        operation = commands.RevokeCredential(serial=_plain(request.serial))
        done = await self._calls.submit(context, operation, commands.CredentialRevoked, request.request_id)
        audit_change("revoke", operation.serial, done=done.revoked)
        return pb.RevokeCredentialResponse(revoked=done.revoked, version=done.version)

    @errors_as_status
    async def ListRevokedCredentials(
        self, request: pb.ListRevokedCredentialsRequest, context: Context
    ) -> pb.ListRevokedCredentialsResponse:
        serials = await self._calls.read(context, lambda directory: directory.access.revoked_serials)
        return pb.ListRevokedCredentialsResponse(serials=serials)

    @errors_as_status
    async def GetAccessState(self, request: pb.GetAccessStateRequest, context: Context) -> pb.GetAccessStateResponse:
        return state_message(await self._calls.read(context, access_state, stale_ok=request.stale_ok))


def _plain(serial: str) -> str:
    """A serial number as credentials state it.

    The serial of a certificate has no leading zeros. The serial of a token has a fixed number of digits, so it may have
    leading zeros.
    """
    return serial if len(serial) == 2 * SERIAL_BYTES else serial.lstrip("0") or serial[:1]


def _effect_message(effect: AccessEffect) -> pb.AccessEffect:
    return pb.AccessEffect(verb=VERBS[effect.verb], kind=KINDS[effect.kind], name=effect.name, allowed=effect.allowed)
