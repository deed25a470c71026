"""Rules of access, and how they judge."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.access.caller import ANYONE, Caller, CallerKind, by_secret
from stampede_rt_runtime.access.rules import AccessKind, AccessRule, AccessRules, AccessVerb, check_rule
from stampede_rt_runtime.identity import Role

READ, PUT, LIST, SEND = AccessVerb.READ, AccessVerb.PUT, AccessVerb.LIST, AccessVerb.SEND
CHANNEL, QUEUE, PEER = AccessKind.CHANNEL, AccessKind.QUEUE, AccessKind.PEER


def client(name: str) -> Caller:
    return Caller(kind=CallerKind.TOKEN, roles=frozenset({Role.CLIENT}), name=name)


def allow(who: str, verbs: tuple[AccessVerb, ...], names: str, kind: AccessKind | None = None) -> AccessRule:
    return AccessRule(who, verbs, kind, names)


def deny(who: str, verbs: tuple[AccessVerb, ...], names: str, kind: AccessKind | None = None) -> AccessRule:
    return AccessRule(who, verbs, kind, names, deny=True)


def test_without_rules_everything_is_allowed() -> None:
    assert AccessRules().judge(client("cam"), PUT, CHANNEL, "video").allowed


def test_everything_without_an_allowing_rule_is_denied_if_there_are_rules() -> None:
    rules = AccessRules([allow("cam-*", (PUT,), "video/*")])
    assert rules.judge(client("cam-1"), PUT, CHANNEL, "video/1").allowed
    for who, verb, name in (("cam-1", READ, "video/1"), ("cam-1", PUT, "audio/1"), ("dash", PUT, "video/1")):
        assert not rules.judge(client(who), verb, CHANNEL, name).allowed


def test_a_denying_rule_wins_over_all_allowing_rules_in_any_order() -> None:
    rules = [allow("*", (), "*"), deny("cam-1", (PUT,), "video/*"), allow("cam-1", (PUT,), "video/1")]
    for ordered in (rules, rules[::-1]):
        judged = AccessRules(ordered).judge(client("cam-1"), PUT, CHANNEL, "video/1")
        assert (judged.allowed, judged.rule) == (False, rules[1])


def test_a_rule_for_one_kind_of_thing_has_no_effect_on_other_kinds() -> None:
    rules = AccessRules([allow("*", (LIST,), "*", QUEUE)])
    assert rules.judge(client("a"), LIST, QUEUE, "q").allowed
    assert not rules.judge(client("a"), LIST, CHANNEL, "q").allowed


def test_rules_do_not_judge_services_and_operators() -> None:
    rules = AccessRules([deny("*", (), "*"), deny("@*", (), "*")])
    operator = Caller(kind=CallerKind.CERTIFICATE, roles=frozenset({Role.OPERATOR}), name="op")
    for caller in (ANYONE, by_secret(of_cluster=True), operator):
        assert rules.judge(caller, READ, CHANNEL, "x").allowed
    assert not rules.judge(by_secret(of_cluster=False), READ, CHANNEL, "x").allowed


def test_rules_can_name_the_holders_of_the_clients_secret() -> None:
    rules = AccessRules([allow("@clients", (READ,), "public/*")])
    assert rules.judge(by_secret(of_cluster=False), READ, CHANNEL, "public/1").allowed
    assert not rules.judge(client("clients"), READ, CHANNEL, "public/1").allowed


def test_a_caller_with_any_right_to_a_thing_may_know_that_it_exists() -> None:
    rules = AccessRules([allow("cam", (PUT,), "v"), allow("send", (SEND,), "p", PEER)])
    assert rules.knows_of(client("cam"), CHANNEL, "v")
    assert not rules.knows_of(client("cam"), QUEUE, "v")
    assert rules.knows_of(client("send"), PEER, "p")
    assert not rules.knows_of(client("send"), QUEUE, "p")


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        (allow("", (), "*"), "who of a rule is ''"),
        (allow("a b", (), "*"), "who of a rule"),
        (allow("a", (), ""), "the names of a rule"),
        (allow("a", (), "x" * 257), "the names of a rule"),
        (allow("a", (), "@x"), "the names of a rule"),
        (allow("a", (PUT,), "x", QUEUE), "nobody can put a queue; its verbs are"),
        (allow("a", (PUT, PUT), "x"), "ascending, each once"),
    ],
)
def test_a_rule_whose_pattern_can_match_no_name_is_refused(rule: AccessRule, expected: str) -> None:
    with pytest.raises(InvalidArgument, match=expected):
        check_rule(rule)


def test_a_pattern_of_many_stars_is_judged_in_a_few_steps() -> None:
    """A pattern matcher that backtracks would take for ever."""
    rules = AccessRules([allow("*a" * 100 + "b", (), "*a" * 100 + "b")])
    assert not rules.judge(client("a" * 128), READ, CHANNEL, "a" * 128).allowed
