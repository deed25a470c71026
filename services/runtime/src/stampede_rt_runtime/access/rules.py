"""The rules of access and their evaluation. Pure.

A rule that denies overrides all rules that allow. Without any rule everything is allowed. With one or more rules,
everything that no rule allows is denied.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.access.caller import Caller
from stampede_rt_runtime.globs import matcher

RULES_MAX = 1000
GLOB_CHARACTERS_MAX = 256
_NAMES = re.compile(r"[A-Za-z0-9._/*?-]+", re.ASCII)
# a name that begins with "@" means a group of callers without names of their own
_WHO = re.compile(r"@?[A-Za-z0-9._/*?-]+", re.ASCII)
_CALLERS_KEPT_MAX = _JUDGEMENTS_KEPT_MAX = 8192


class AccessVerb(StrEnum):
    """The kinds of actions on a thing."""

    READ = "read"
    PUT = "put"
    CONSUME = "consume"
    ADVANCE = "advance"
    CREATE = "create"
    CONFIGURE = "configure"
    DELETE = "delete"
    TAKE = "take"
    SEND = "send"
    REGISTER = "register"
    LIST = "list"


class AccessKind(StrEnum):
    """The kinds of things. A mailbox counts as its peer."""

    CHANNEL = "channel"
    GROUP = "group"
    QUEUE = "queue"
    PEER = "peer"


_MANAGING = (AccessVerb.CREATE, AccessVerb.CONFIGURE, AccessVerb.DELETE, AccessVerb.LIST)
VERBS_OF: Mapping[AccessKind, frozenset[AccessVerb]] = {
    AccessKind.CHANNEL: frozenset(
        {AccessVerb.READ, AccessVerb.PUT, AccessVerb.CONSUME, AccessVerb.ADVANCE, *_MANAGING}
    ),
    AccessKind.GROUP: frozenset({AccessVerb.READ, *_MANAGING}),
    AccessKind.QUEUE: frozenset({AccessVerb.SEND, AccessVerb.TAKE, *_MANAGING}),
    AccessKind.PEER: frozenset({AccessVerb.REGISTER, AccessVerb.SEND, AccessVerb.TAKE, AccessVerb.LIST}),
}


@dataclass(frozen=True, slots=True)
class AccessRule:
    """One rule. `who`: a pattern over the names of callers. `names`: a pattern over the names of things.

    `verbs`: ascending, each once; empty: all. `kind` None: every kind.
    """

    who: str
    verbs: tuple[AccessVerb, ...]
    kind: AccessKind | None
    names: str
    deny: bool = False

    def __str__(self) -> str:
        effect, verbs = "deny" if self.deny else "allow", ",".join(self.verbs) or "*"
        return f"{effect} {self.who} {verbs} {self.names}" + (f" (kind {self.kind})" if self.kind else "")


def check_rule(rule: AccessRule) -> None:
    """Raises InvalidArgument for a rule with an invalid pattern, or with verbs that its kind does not have."""
    for text, what, form in ((rule.who, "who", _WHO), (rule.names, "the names", _NAMES)):
        if not 0 < len(text) <= GLOB_CHARACTERS_MAX or form.fullmatch(text) is None:
            raise InvalidArgument(
                f"{what} of a rule is {text[:64]!r}; write a name or pattern of 1 to {GLOB_CHARACTERS_MAX} characters, "
                "with '*' for any run of characters and '?' for one"
            )
    if tuple(sorted(set(rule.verbs))) != rule.verbs:
        raise InvalidArgument("the verbs of a rule must be ascending, each once")
    if rule.kind is not None and not VERBS_OF[rule.kind].issuperset(rule.verbs):
        wrong = sorted(set(rule.verbs) - VERBS_OF[rule.kind])
        raise InvalidArgument(
            f"nobody can {' or '.join(wrong)} a {rule.kind}; its verbs are {', '.join(sorted(VERBS_OF[rule.kind]))}"
        )


@dataclass(frozen=True, slots=True)
class AccessRuling:
    """Whether the action is allowed, and the deciding rule.

    `rule` None: there are no rules, no rule matches, or rules do not judge the caller.
    """

    allowed: bool
    rule: AccessRule | None = None


class AccessRules:
    """All rules of a cluster, prepared for evaluation.

    They never change. The memory for remembered answers has a bound.
    """

    def __init__(self, rules: Iterable[AccessRule] = ()) -> None:
        self.rules = tuple(rules)
        self._rules_of_callers: dict[str, list[tuple[AccessRule, Callable[[str], bool]]]] = {}
        self._judged: dict[tuple[str, AccessVerb, AccessKind, str], AccessRuling] = {}

    def judge(self, caller: Caller, verb: AccessVerb, kind: AccessKind, name: str) -> AccessRuling:
        """Whether `caller` may do `verb` with the thing of that kind and name."""
        if not caller.is_judged or not self.rules:
            return AccessRuling(True)
        key = (caller.name, verb, kind, name)
        found = self._judged.get(key)
        if found is None:
            if len(self._judged) >= _JUDGEMENTS_KEPT_MAX:
                self._judged.clear()
            found = self._judged[key] = self._decide(*key)
        return found

    def knows_of(self, caller: Caller, kind: AccessKind, name: str) -> bool:
        """Whether `caller` may do at least one kind of action with the thing, and so may learn of it."""
        return any(self.judge(caller, verb, kind, name).allowed for verb in VERBS_OF[kind])

    def _decide(self, who: str, verb: AccessVerb, kind: AccessKind, name: str) -> AccessRuling:
        allowing: AccessRule | None = None
        for rule, matches in self._rules_for(who):
            if rule.kind not in (None, kind) or (rule.verbs and verb not in rule.verbs) or not matches(name):
                continue
            if rule.deny:
                return AccessRuling(False, rule)
            allowing = allowing or rule
        return AccessRuling(allowing is not None, allowing)

    def _rules_for(self, who: str) -> list[tuple[AccessRule, Callable[[str], bool]]]:
        if who not in self._rules_of_callers:
            if len(self._rules_of_callers) >= _CALLERS_KEPT_MAX:
                self._rules_of_callers.clear()
            theirs = (rule for rule in self.rules if matcher(rule.who)(who))
            self._rules_of_callers[who] = [(rule, matcher(rule.names)) for rule in theirs]
        return self._rules_of_callers[who]


NO_RULES = AccessRules()
