"""The rules of access and a simple judge agree. The judge looks at every rule, and at each character of a name."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_runtime.access.caller import Caller, CallerKind
from stampede_rt_runtime.access.rules import VERBS_OF, AccessKind, AccessRule, AccessRules, AccessVerb
from stampede_rt_runtime.identity import Role

NAMES = st.text("ab/", min_size=1, max_size=5)
GLOBS = st.text("ab/*?", min_size=1, max_size=6)
VERBS = st.lists(st.sampled_from(AccessVerb), unique=True, max_size=4).map(lambda verbs: tuple(sorted(verbs)))
RULES = st.lists(
    st.builds(AccessRule, GLOBS, VERBS, st.none() | st.sampled_from(AccessKind), GLOBS, st.booleans()), max_size=8
)


def matches(glob: str, name: str) -> bool:
    if not glob:
        return not name
    if glob[0] == "*":
        return matches(glob[1:], name) or (bool(name) and matches(glob, name[1:]))
    return bool(name) and glob[0] in ("?", name[0]) and matches(glob[1:], name[1:])


def oracle(rules: list[AccessRule], who: str, verb: AccessVerb, kind: AccessKind, name: str) -> bool:
    about = [
        rule
        for rule in rules
        if matches(rule.who, who)
        and (not rule.verbs or verb in rule.verbs)
        and rule.kind in (None, kind)
        and matches(rule.names, name)
    ]
    return not rules or (any(not rule.deny for rule in about) and not any(rule.deny for rule in about))


def client(name: str) -> Caller:
    return Caller(kind=CallerKind.CERTIFICATE, roles=frozenset({Role.CLIENT}), name=name)


@given(RULES, st.lists(st.tuples(NAMES, st.sampled_from(AccessVerb), st.sampled_from(AccessKind), NAMES), max_size=6))
def test_the_access_rules_agree_with_a_simple_implementation(
    rules: list[AccessRule], questions: list[tuple[str, AccessVerb, AccessKind, str]]
) -> None:
    judge = AccessRules(rules)
    for who, verb, kind, name in questions * 2:  # the second time the answer comes from the cache
        assert judge.judge(client(who), verb, kind, name).allowed == oracle(rules, who, verb, kind, name)


@given(RULES, NAMES, st.sampled_from(AccessKind), NAMES)
def test_a_caller_may_list_everything_that_it_may_use(
    rules: list[AccessRule], who: str, kind: AccessKind, name: str
) -> None:
    knows = any(oracle(rules, who, verb, kind, name) for verb in VERBS_OF[kind])
    assert AccessRules(rules).knows_of(client(who), kind, name) == knows


@given(RULES, RULES, NAMES, st.sampled_from(AccessVerb), st.sampled_from(AccessKind), NAMES)
def test_the_order_of_rules_does_not_matter_and_no_rule_overrides_a_denial(
    rules: list[AccessRule], more: list[AccessRule], who: str, verb: AccessVerb, kind: AccessKind, name: str
) -> None:
    ruling = AccessRules(rules).judge(client(who), verb, kind, name)
    assert AccessRules(rules[::-1]).judge(client(who), verb, kind, name).allowed == ruling.allowed
    if ruling.rule is not None and ruling.rule.deny:
        assert not AccessRules([*rules, *more]).judge(client(who), verb, kind, name).allowed
