"""The rows of access in the command table. Pure."""

from __future__ import annotations

import re
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.access.rules import check_rule
from stampede_rt_runtime.access.tokens import KEY_BYTES
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
from stampede_rt_supernode.core.access.quota_commands import QuotasRemoved, QuotasSet, RemoveQuotas, SetQuotas
from stampede_rt_supernode.core.access.quota_transitions import (
    check_remove_quotas,
    check_set_quotas,
    remove_quotas,
    set_quotas,
)
from stampede_rt_supernode.core.access.transitions import (
    add_access_rule,
    create_token_key,
    remove_access_rule,
    revoke_credential,
)
from stampede_rt_supernode.core.command_kinds import CommandKind


def _check_key(operation: CreateTokenKey) -> None:
    if len(operation.new_token_key) != KEY_BYTES:
        raise InvalidArgument(
            f"the key of client tokens has {len(operation.new_token_key)} bytes; it needs {KEY_BYTES}"
        )


def _check_serial(operation: RevokeCredential) -> None:
    if re.fullmatch(r"[0-9a-f]{1,64}", operation.serial) is None:
        raise InvalidArgument(
            f"serial is {operation.serial[:80]!r}; it has 1 to 64 hexadecimal digits in lower case, as `stampede certs "
            "show` and `stampede token issue` show them"
        )


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=CreateTokenKey,
        result=TokenKeyCreated,
        feature_level=2,
        subject=lambda one: "",
        check=_check_key,
        apply=create_token_key,
    ),
    CommandKind(
        operation=RevokeCredential,
        result=CredentialRevoked,
        feature_level=2,
        subject=lambda one: one.serial,
        check=_check_serial,
        apply=revoke_credential,
    ),
    CommandKind(
        operation=AddAccessRule,
        result=AccessRuleAdded,
        feature_level=2,
        subject=lambda one: str(one.rule),
        check=lambda one: check_rule(one.rule),
        apply=add_access_rule,
    ),
    CommandKind(
        operation=RemoveAccessRule,
        result=AccessRuleRemoved,
        feature_level=2,
        subject=lambda one: str(one.rule),
        check=lambda one: check_rule(one.rule),
        apply=remove_access_rule,
    ),
    CommandKind(
        operation=SetQuotas,
        result=QuotasSet,
        feature_level=2,
        subject=lambda one: ",".join(map(str, one.settings)),
        check=check_set_quotas,
        apply=set_quotas,
    ),
    CommandKind(
        operation=RemoveQuotas,
        result=QuotasRemoved,
        feature_level=2,
        subject=lambda one: f"{one.who} {','.join(one.quotas)}",
        check=check_remove_quotas,
        apply=remove_quotas,
    ),
)
