"""Converts rules of access from and to protobuf. Makes no decisions."""

from __future__ import annotations

from collections.abc import Mapping

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import access_pb2 as pb
from stampede_rt.v1 import access_service_pb2
from stampede_rt_runtime.access.control import AccessControl, current_caller
from stampede_rt_runtime.access.rules import AccessKind, AccessRule, AccessRules, AccessVerb
from stampede_rt_runtime.access.state import AccessState
from stampede_rt_runtime.quotas.limits import QuotaTable
from stampede_rt_runtime.quotas.messages import known_settings, setting_message

VERBS: Mapping[AccessVerb, pb.AccessVerb] = {verb: getattr(pb, f"ACCESS_VERB_{verb.name}") for verb in AccessVerb}
KINDS: Mapping[AccessKind, pb.AccessKind] = {kind: getattr(pb, f"ACCESS_KIND_{kind.name}") for kind in AccessKind}
_VERBS_FROM: Mapping[int, AccessVerb] = {int(number): verb for verb, number in VERBS.items()}
_KINDS_FROM: Mapping[int, AccessKind] = {int(number): kind for kind, number in KINDS.items()}


def rule_message(rule: AccessRule) -> pb.AccessRule:
    """The message of a rule."""
    return pb.AccessRule(
        who=rule.who,
        verbs=[VERBS[verb] for verb in rule.verbs],
        kind=pb.ACCESS_KIND_UNSPECIFIED if rule.kind is None else KINDS[rule.kind],
        names=rule.names,
        deny=rule.deny,
    )


def rule_from(message: pb.AccessRule) -> AccessRule:
    """The rule of a message. Raises InvalidArgument for an unknown verb or kind."""
    return AccessRule(
        message.who,
        tuple(sorted(set(map(verb_from, message.verbs)))),
        kind_from(message.kind) if message.kind else None,
        message.names,
        message.deny,
    )


def verb_from(number: int) -> AccessVerb:
    """The verb of a number. Raises InvalidArgument."""
    if number not in _VERBS_FROM:
        raise InvalidArgument(f"this service knows no verb {number} of access; name one of AccessVerb")
    return _VERBS_FROM[number]


def kind_from(number: int) -> AccessKind:
    """The kind of a number. Raises InvalidArgument."""
    if number not in _KINDS_FROM:
        raise InvalidArgument(f"this service knows no kind {number} of access; name one of AccessKind")
    return _KINDS_FROM[number]


def state_message(state: AccessState) -> access_service_pb2.GetAccessStateResponse:
    """The state as supernodes send it to other services."""
    return access_service_pb2.GetAccessStateResponse(
        version=state.version,
        cluster_id=state.cluster_id,
        rules=map(rule_message, state.rules.rules),
        token_keys=state.token_keys,
        revoked_serials=sorted(state.revoked_serials),
        quotas=map(setting_message, state.quotas.settings),
    )


def state_from(message: access_service_pb2.GetAccessStateResponse) -> AccessState:
    """The state of a message. Raises InvalidArgument for a rule with an unknown verb or kind."""
    return AccessState(
        version=message.version,
        cluster_id=message.cluster_id,
        rules=AccessRules(map(rule_from, message.rules)),
        token_keys=tuple(message.token_keys),
        revoked_serials=frozenset(message.revoked_serials),
        quotas=QuotaTable(known_settings(message.quotas)),
    )


def status_message(control: AccessControl) -> pb.AccessStatus:
    """The access status of a port."""
    return pb.AccessStatus(
        version=control.version,
        denials=control.audit.denials,
        denied_ago_nanos=control.audit.denied_ago_nanos(),
        quota_refusals=control.accounts.refusals,
        quota_refused_ago_nanos=control.accounts.refused_ago_nanos(),
        limits_caller=control.limits(current_caller()),
    )
