"""`stampede quota set|rm|ls|check|use`: the limits of each caller's use of a host or supernode, and the use itself."""

from __future__ import annotations

import argparse
import re
import secrets
import sys
from collections.abc import Iterable
from ipaddress import ip_address
from typing import Any

from stampede_rt.cli.arguments import add_verb
from stampede_rt.cli.output import bytes_text, print_behind, print_facts, print_rows
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.escaping import escaped

QUOTAS = (
    "streams", "subscriptions", "waiting-calls", "bytes-in-flight", "channels", "queues", "groups", "peers",
    "changes-per-second", "bytes-held", "bytes-archived", "cpu-percent",
)  # fmt: skip
IN_BYTES = frozenset({"bytes-in-flight", "bytes-held", "bytes-archived"})
# The default limit of each of these quotas is 7/8 of the named setting of the host.
OF_EACH_HOST = {"bytes-held": "--memory-bytes-max", "bytes-archived": "--archive-bytes-max"}
DEFAULT = "(default)"  # the text for the subject of a default limit
UNLIMITED = 2**62  # a limit of this number or more is no limit
_UNITS = {"": 1, "B": 1, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
_LIMIT = re.compile(r"(\d{1,19})\s*(B|KiB|MiB|GiB)?", re.ASCII)
_WHO_HELP = (
    'a client\'s name, "@ADDRESS" for callers whose credential has no name, or a pattern such as "cam-*" or "@10.*"'
)


def add_verbs(subparsers: Any) -> None:
    """Add the noun of this module and its verbs."""
    text = (
        "quotas: how much one caller may use of a host or supernode; for operators and holders of the cluster's secret"
    )
    noun = subparsers.add_parser("quota", help=text, description=text)
    verbs = noun.add_subparsers(dest="quota_verb", metavar="VERB", required=True, parser_class=VerbParser)
    set_ = add_verb(verbs, "set", "set limits; for each caller the longest matching pattern counts", run_set)
    set_.add_argument("who", metavar="WHO", help=_WHO_HELP)
    set_.add_argument(
        "limits", metavar="QUOTA=LIMIT", nargs="+", type=_limit,
        help=f"{', '.join(QUOTAS)}; a number, bytes also with KiB, MiB, GiB; or `unlimited`",
    )  # fmt: skip
    rm = add_verb(verbs, "rm", "remove limits; the next shorter pattern or the default counts from then on", run_rm)
    rm.add_argument("who", metavar="WHO", help="the same text as in `quota set`")
    rm.add_argument("quotas", metavar="QUOTA", nargs="*", type=_quota, help="default: all quotas of WHO")
    add_verb(verbs, "ls", "list all limits that were set, and the defaults", run_ls)
    check = add_verb(verbs, "check", "print the limits of one caller, each with the setting that decides it", run_check)
    check.add_argument("who", metavar="WHO", help='the name of the caller, or "@ADDRESS"')
    use = add_verb(
        verbs, "use", "show the usage and the refusals of each caller at each service of the cluster", run_use
    )
    use.add_argument("who", metavar="WHO", nargs="?", default="", help="a pattern; default: all callers")


def _quota(text: str) -> str:
    if text not in QUOTAS:
        raise argparse.ArgumentTypeError(f"there is no quota {text!r}; the quotas are {', '.join(QUOTAS)}")
    return text


def _limit(text: str) -> tuple[str, int]:
    name, equals, value = text.partition("=")
    quota, match = _quota(name), _LIMIT.fullmatch(value)
    if value == "unlimited":
        return quota, UNLIMITED
    if not equals or match is None or (match[2] and quota not in IN_BYTES):
        example = f"{quota}=64MiB" if quota in IN_BYTES else f"{quota}=100"
        raise argparse.ArgumentTypeError(f"{text!r} sets no limit; write it as {example}, or {quota}=unlimited")
    return quota, int(match[1]) * _UNITS[match[2] or ""]


def _check_who(who: str) -> None:
    """Raise InvalidArgument for an address without "@". A service would take it for the name of a client."""
    try:
        ip_address(who)
    except ValueError:
        return
    raise InvalidArgument(f"{who} is an address; write @{who}")


def run_set(arguments: argparse.Namespace) -> int:
    """Set limits."""
    from stampede_rt.administration.running_cluster import reached  # here and below: gRPC takes 0.1 s to load
    from stampede_rt.v1 import quota_pb2
    from stampede_rt.v1 import quota_service_pb2 as pb

    _check_who(arguments.who)
    request = pb.SetQuotasRequest(request_id=secrets.token_bytes(16))
    for quota, limit in arguments.limits:
        request.settings.append(quota_pb2.QuotaSetting(who=arguments.who, kind=_kind(quota), limit=limit))
    with reached(arguments.url, None) as cluster:
        answer = cluster.ask_quotas("SetQuotas", request)
        print_behind(cluster.parts_behind(answer.version, of_rules=True))
    if arguments.output != "table":
        print_facts({"changed": answer.changed, "settings": list(map(_row, request.settings))}, arguments.output)
        return 0
    for quota, limit in arguments.limits:
        print(f"{quota} of {arguments.who} is {_text(quota, limit)}" + ("." if answer.changed else " already."))
    return 0


def run_rm(arguments: argparse.Namespace) -> int:
    """Remove limits."""
    from stampede_rt.administration.running_cluster import reached
    from stampede_rt.v1 import quota_service_pb2 as pb

    request = pb.RemoveQuotasRequest(
        request_id=secrets.token_bytes(16), who=arguments.who, kinds=map(_kind, arguments.quotas)
    )
    with reached(arguments.url, None) as cluster:
        answer = cluster.ask_quotas("RemoveQuotas", request)
        print_behind(cluster.parts_behind(answer.version, of_rules=True))
    if arguments.output != "table":
        print_facts({"removed": answer.removed}, arguments.output)
    elif not answer.removed:
        print(f"No such limit was set for {arguments.who}.")
    else:
        what = f"{answer.removed} limit{'' if answer.removed == 1 else 's'} of {arguments.who}"
        print(f"{what} {'is' if answer.removed == 1 else 'are'} removed.")
    return 0


def run_ls(arguments: argparse.Namespace) -> int:
    """List all limits."""
    from stampede_rt.v1 import quota_service_pb2 as pb

    listed = _answer_to(arguments, "ListQuotas", pb.ListQuotasRequest())
    rows = sorted(map(_row, listed.settings), key=lambda row: (row["who"], row["quota"]))
    rows += [_limit_row(one.kind, one.limit) | {"who": DEFAULT} for one in listed.defaults]
    _print(rows, arguments.output, ("who", "quota", "limit"))
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Print the limits of one caller."""
    from stampede_rt.v1 import quota_service_pb2 as pb

    _check_who(arguments.who)
    answer = _answer_to(arguments, "CheckQuotas", pb.CheckQuotasRequest(subject=arguments.who))
    rows = [
        _limit_row(one.kind, one.limit) | {"set_for": one.setting.who if one.HasField("setting") else DEFAULT}
        for one in answer.limits
    ]
    _print(rows, arguments.output, ("quota", "limit", "set_for"))
    return 0


def run_use(arguments: argparse.Namespace) -> int:
    """Print how much of its quotas each caller uses, and how many of its calls were refused."""
    from stampede_rt.administration.running_cluster import reached

    with reached(arguments.url, None) as cluster:
        uses = list(cluster.quota_uses(arguments.who))
    for part in uses:
        if part.failure:
            print(f"stampede: {escaped(part.part)} did not answer: {escaped(part.failure)}", file=sys.stderr)
    if all(part.failure for part in uses):
        raise StampedeError("no service of the cluster reported the usage of its quotas")
    rows = [
        {"who": use.subject, "at": part.part}
        | _limit_row(use.kind, use.limit)
        | {"used": use.used, "refused": use.refused}
        for part in uses
        for use in part.uses
    ]
    nobody = f"no caller that matches {arguments.who!r} uses any quota" if arguments.who else "no caller uses any quota"
    rows.sort(key=lambda row: (-row["refused"], row["who"], row["at"], row["quota"]))
    _print(rows, arguments.output, ("who", "at", "quota", "used", "limit", "refused"), none=nobody)
    return 0


def _answer_to(arguments: argparse.Namespace, rpc: str, request: Any) -> Any:
    from stampede_rt.administration.running_cluster import reached

    with reached(arguments.url, None) as cluster:
        return cluster.ask_quotas(rpc, request)


def _print(rows: Iterable[dict[str, Any]], output: str, columns: tuple[str, ...], none: str = "") -> None:
    """Print `columns` of `rows`. A table has numbers as texts for people, JSON has plain numbers."""
    if output == "table":
        rows = [row | {key: _amount_text(row, key) for key in ("limit", "used") if key in row} for row in rows]
    print_rows([{column: row[column] for column in columns} for row in rows], output, none=none)


def _row(setting: Any) -> dict[str, Any]:
    return {"who": setting.who} | _limit_row(setting.kind, setting.limit)


def _limit_row(kind: int, limit: int) -> dict[str, Any]:
    return {"quota": _name(kind), "limit": limit}


def _amount_text(row: dict[str, Any], key: str) -> str:
    if row["quota"] in OF_EACH_HOST and row[key] == UNLIMITED and DEFAULT in row.values():
        return f"7/8 of each host's {OF_EACH_HOST[row['quota']]}"
    return _text(row["quota"], row[key])


def _text(quota: str, amount: int) -> str:
    if amount >= UNLIMITED:
        return "unlimited"
    return bytes_text(amount) if quota in IN_BYTES else f"{amount:,}"


def _kind(quota: str) -> Any:
    from stampede_rt.v1 import quota_pb2

    return getattr(quota_pb2, f"QUOTA_KIND_{quota.upper().replace('-', '_')}")


def _name(kind: int) -> str:
    """Return the name of a quota, or its number if a newer service sends a kind that this release does not know."""
    from stampede_rt.v1 import quota_pb2

    if kind not in quota_pb2.QuotaKind.values():
        return f"quota {kind}"
    return quota_pb2.QuotaKind.Name(kind).removeprefix("QUOTA_KIND_").lower().replace("_", "-")
