"""The effects of a change of rules, computed before the change. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

from stampede_rt_runtime.access.caller import ALL_ROLES, Caller, CallerKind
from stampede_rt_runtime.access.rules import VERBS_OF, AccessKind, AccessRule, AccessRules, AccessVerb
from stampede_rt_runtime.globs import matcher
from stampede_rt_runtime.identity import Role
from stampede_rt_supernode.core.glob import fixed_prefix
from stampede_rt_supernode.core.queries import names_from
from stampede_rt_supernode.core.tables import Tables

EFFECTS_MAX = 100
NAMES_EXAMINED_MAX = 1000  # the most names of each kind of thing that one call examines


@dataclass(frozen=True, slots=True)
class AccessEffect:
    """A right that is `allowed` after the change and was not before, or the reverse."""

    verb: AccessVerb
    kind: AccessKind
    name: str
    allowed: bool


def client_named(who: str) -> Caller:
    """The client of that name, for `AccessRules.judge`. "@cluster" names the holders of the cluster's secret."""
    if who == "@cluster":
        return Caller(kind=CallerKind.CLUSTER_SECRET, roles=ALL_ROLES, name=who)
    return Caller(kind=CallerKind.TOKEN, roles=frozenset({Role.CLIENT}), name=who)


def with_rule(rules: AccessRules, rule: AccessRule) -> AccessRules:
    """The rules with `rule`, which is not added twice."""
    return rules if rule in rules.rules else AccessRules((*rules.rules, rule))


def without_rule(rules: AccessRules, rule: AccessRule) -> AccessRules:
    """The rules without `rule`."""
    return AccessRules(one for one in rules.rules if one != rule)


def effects_on(tables: Tables, before: AccessRules, after: AccessRules, rule: AccessRule) -> list[AccessEffect]:
    """The changed rights of a client with the name `rule.who`, on existing things to which the rule applies.

    Returns EFFECTS_MAX rights at most. Examines only the first NAMES_EXAMINED_MAX names of each kind.
    """
    return list(islice(_effects(tables, before, after, rule), EFFECTS_MAX))


def _effects(tables: Tables, before: AccessRules, after: AccessRules, rule: AccessRule) -> Iterator[AccessEffect]:
    caller = client_named(rule.who)
    for kind in AccessKind if rule.kind is None else (rule.kind,):
        for name in _names(tables, kind, rule.names):
            for verb in sorted(VERBS_OF[kind]):
                allowed = after.judge(caller, verb, kind, name).allowed
                if allowed != before.judge(caller, verb, kind, name).allowed:
                    yield AccessEffect(verb, kind, name, allowed)


def _names(tables: Tables, kind: AccessKind, glob: str) -> Iterator[str]:
    ids = {
        AccessKind.CHANNEL: tables.channel_ids,
        AccessKind.GROUP: tables.groups.ids,
        AccessKind.QUEUE: tables.queues.ids,
        AccessKind.PEER: tables.peers.ids,
    }[kind]
    return filter(matcher(glob), islice(names_from(ids, fixed_prefix(glob), ""), NAMES_EXAMINED_MAX))
