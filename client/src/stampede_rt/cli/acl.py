"""`stampede acl add|rm|ls|check`: rules that say what a client may do."""

from __future__ import annotations

import argparse
import secrets
from collections.abc import Sequence
from typing import Any

from stampede_rt.cli.arguments import add_verb
from stampede_rt.cli.output import print_behind, print_facts, print_rows
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.errors import InvalidArgument

VERBS = (
    "read", "put", "consume", "advance", "create", "configure", "delete", "take", "send", "register", "list",
)  # fmt: skip
KINDS = ("channel", "group", "queue", "peer")
KINDS_OF = {
    "read": ("channel", "group"), "put": ("channel",), "consume": ("channel",), "advance": ("channel",),
    "create": ("channel", "group", "queue"), "configure": ("channel", "group", "queue"),
    "delete": ("channel", "group", "queue"), "take": ("queue", "peer"), "send": ("queue", "peer"),
    "register": ("peer",), "list": KINDS,
}  # fmt: skip
_EXPLANATION = """The verbs of each kind of thing:
{verbs}
A mailbox counts as its peer. The caller that registers a peer may take from its mailbox.

In WHO and NAME "*" matches any characters, also "/", and "?" matches one. A rule that denies overrides all rules that
allow. Without any rule clients may do everything. Rules do not limit operators or holders of the cluster's secret."""
NOT_ALLOWED = 3  # the exit status of `check` if a client may not do something
EFFECTS_SHOWN = 20  # rows of a table of effects


def add_verbs(subparsers: Any) -> None:
    """Add the noun of this module and its verbs."""
    text = "rules of access, which say who may do what; for operators and holders of the cluster's secret"
    listed = (f"  {kind:<9}{', '.join(verb for verb in VERBS if kind in KINDS_OF[verb])}" for kind in KINDS)
    noun = subparsers.add_parser(
        "acl",
        help=text,
        description=text,
        epilog=_EXPLANATION.format(verbs="\n".join(listed)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = noun.add_subparsers(dest="acl_verb", metavar="VERB", required=True, parser_class=VerbParser)
    _add_change(
        add_verb(verbs, "add", "add a rule; if any rule exists, clients may do only what a rule allows", run_add)
    )
    _add_change(add_verb(verbs, "rm", "remove a rule; give the rule in the form of `acl add`", run_rm))
    add_verb(verbs, "ls", "list all rules", run_ls)
    check = add_verb(verbs, "check", "tell whether a client may do something, and why; status 3: it may not", run_check)
    check.add_argument("who", metavar="WHO", help="the name of a client")
    check.add_argument("action", metavar="VERB", choices=VERBS, help=", ".join(VERBS))
    check.add_argument("name", metavar="NAME", help="the name of a thing")
    check.add_argument("--kind", choices=KINDS, help="the kind of the thing; default: the first kind that has the verb")


def _add_change(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "who", metavar="WHO", help='names of clients, such as "cam-*"; @clients: all clients with the shared secret'
    )
    parser.add_argument("actions", metavar="VERB,...", type=_verbs, help=f"{', '.join(VERBS)}; * for all")
    parser.add_argument("names", metavar="NAME", help='names of things, such as "video/*"')
    parser.add_argument("--kind", choices=KINDS, help="only things of this kind; default: every kind")
    parser.add_argument("--deny", action="store_true", help="forbid the verbs, even if other rules allow them")
    parser.add_argument(
        "--dry-run", action="store_true", help="change nothing, and print the effects that the change would have"
    )


def _verbs(text: str) -> tuple[str, ...]:
    words = () if text == "*" else tuple(sorted(set(text.split(","))))
    if wrong := [word for word in words if word not in VERBS]:
        raise argparse.ArgumentTypeError(
            f"there is no verb {', '.join(wrong)!r}; the verbs are {', '.join(VERBS)}, or * for all"
        )
    return words


def run_add(arguments: argparse.Namespace) -> int:
    """Add a rule."""
    return _change(arguments, "AddAccessRule", ("added", "was there already"))


def run_rm(arguments: argparse.Namespace) -> int:
    """Remove a rule."""
    return _change(arguments, "RemoveAccessRule", ("removed", "was not there"))


def _change(arguments: argparse.Namespace, rpc: str, outcomes: tuple[str, str]) -> int:
    from stampede_rt.administration.running_cluster import reached  # here and below: gRPC takes 0.1 s to load
    from stampede_rt.v1 import access_service_pb2 as pb

    request = getattr(pb, f"{rpc}Request")(
        request_id=secrets.token_bytes(16), rule=_rule(arguments), dry_run=arguments.dry_run
    )
    with reached(arguments.url, None) as cluster:
        answer = cluster.ask_access(rpc, request)
        if not arguments.dry_run:
            print_behind(cluster.parts_behind(answer.version, of_rules=True))
    did, did_not = outcomes
    changed = getattr(answer, did)
    effects = [_effect_row(effect) for effect in answer.effects]
    if arguments.output != "table":
        print_facts(
            {did: changed, "dry_run": arguments.dry_run, "rules": answer.rules, "effects": effects}, arguments.output
        )
        return 0
    outcome = f"{'would be' if arguments.dry_run else 'is'} {did}" if changed else did_not
    print(f"The rule {outcome}: {_text(request.rule)}.")
    for line in _warnings(rpc, changed=changed, rules=answer.rules):
        print(line)
    _print_effects(arguments.who, effects)
    return 0


def _warnings(rpc: str, *, changed: bool, rules: int) -> list[str]:
    if not changed:
        written = "Write it as `stampede acl ls` shows it, with --kind KIND if KIND is not *, and --deny for a denial."
        return [written] if rpc == "RemoveAccessRule" else []
    if rpc == "AddAccessRule" and rules == 1:
        return [
            "It is the first rule: from now on clients may do only what a rule allows. Members, operators and holders",
            "of the cluster's secret may do everything as before.",
        ]
    if rpc == "RemoveAccessRule" and rules == 0:
        return ["It was the last rule: clients may do everything again."]
    return []


def _print_effects(who: str, effects: Sequence[dict[str, Any]]) -> None:
    if not effects:
        return
    print(f"\nThe effects on {who}, for the things that exist now:\n")
    print_rows(effects[:EFFECTS_SHOWN], "table", none="")
    if len(effects) > EFFECTS_SHOWN:
        print(f"and at least {len(effects) - EFFECTS_SHOWN} more (-o json)")


def run_ls(arguments: argparse.Namespace) -> int:
    """List all rules."""
    from stampede_rt.v1 import access_service_pb2 as pb

    listed = _answer_to(arguments, "ListAccessRules", pb.ListAccessRulesRequest())
    rows = sorted((_rule_row(rule) for rule in listed.rules), key=lambda row: (row["who"], row["names"], row["effect"]))
    print_rows(rows, arguments.output, none="no rules: clients may do everything")
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Print whether a client may do something."""
    from stampede_rt.v1 import access_pb2
    from stampede_rt.v1 import access_service_pb2 as pb

    for text, what in ((arguments.who, "client"), (arguments.name, "thing")):
        if set(text) & set("*?"):
            raise InvalidArgument(f"{text} is a pattern; name one {what}")
    kind, *others = (arguments.kind,) if arguments.kind else KINDS_OF[arguments.action]
    verb = getattr(access_pb2, f"ACCESS_VERB_{arguments.action.upper()}")
    answers = {}
    for one in (kind, *others):
        number = getattr(access_pb2, f"ACCESS_KIND_{one.upper()}")
        request = pb.CheckAccessRequest(who=arguments.who, verb=verb, kind=number, name=arguments.name)
        answers[one] = _answer_to(arguments, "CheckAccess", request)
    answer = answers.pop(kind)
    if answer.HasField("rule"):
        why = f"the rule: {_text(answer.rule)}"
    else:
        why = "there are no rules" if not answer.rules else "no rule allows it"
        if answer.allowed and answer.rules:
            why = "no rule limits it"
    if arguments.output == "table":
        may = "may" if answer.allowed else "may not"
        print(f"A client with the name {arguments.who} {may} {arguments.action} {kind} {arguments.name}: {why}.")
        if not answer.allowed:
            print(
                f"Rules limit clients only. If {arguments.who} is an operator or a service of the cluster, rules do "
                "not limit it."
            )
        for one, other in answers.items():
            if other.allowed != answer.allowed:
                may = "may" if other.allowed else "may not"
                print(f"It {may} {arguments.action} {one} {arguments.name} (--kind {one}).")
    else:
        rule = _rule_row(answer.rule) if answer.HasField("rule") else None
        print_facts({"allowed": answer.allowed, "rule": rule, "why": why}, arguments.output)
    return 0 if answer.allowed else NOT_ALLOWED


def _rule(arguments: argparse.Namespace) -> Any:
    from stampede_rt.v1 import access_pb2

    if not arguments.who or not arguments.names:
        raise InvalidArgument("WHO and NAME must not be empty; write * for all")
    return access_pb2.AccessRule(
        who=arguments.who,
        verbs=[getattr(access_pb2, f"ACCESS_VERB_{verb.upper()}") for verb in arguments.actions],
        kind=getattr(access_pb2, f"ACCESS_KIND_{(arguments.kind or 'unspecified').upper()}"),
        names=arguments.names,
        deny=arguments.deny,
    )


def _answer_to(arguments: argparse.Namespace, rpc: str, request: Any) -> Any:
    from stampede_rt.administration.running_cluster import reached

    with reached(arguments.url, None) as cluster:
        return cluster.ask_access(rpc, request)


def _rule_row(rule: Any) -> dict[str, Any]:
    return {
        "effect": "deny" if rule.deny else "allow",
        "who": rule.who,
        "verbs": ",".join(_verb_name(verb) for verb in rule.verbs) or "*",
        "kind": _kind_name(rule.kind) if rule.kind else "*",
        "names": rule.names,
    }


def _effect_row(effect: Any) -> dict[str, Any]:
    change = "allowed" if effect.allowed else "denied"
    return {
        "verb": _verb_name(effect.verb), "kind": _kind_name(effect.kind), "name": effect.name, "becomes": change
    }  # fmt: skip


def _text(rule: Any) -> str:
    row = _rule_row(rule)
    kind = "" if row["kind"] == "*" else f" (kind {row['kind']})"
    return f"{row['effect']} {row['who']} {row['verbs']} {row['names']}{kind}"


def _verb_name(verb: int) -> str:
    from stampede_rt.v1 import access_pb2

    return access_pb2.AccessVerb.Name(verb).removeprefix("ACCESS_VERB_").lower()


def _kind_name(kind: int) -> str:
    from stampede_rt.v1 import access_pb2

    return access_pb2.AccessKind.Name(kind).removeprefix("ACCESS_KIND_").lower()
