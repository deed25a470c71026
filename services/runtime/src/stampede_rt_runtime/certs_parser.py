"""The parser of `stampede certs`."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

from stampede_rt.administration.output_forms import add_output
from stampede_rt.errors import InvalidArgument
from stampede_rt.escaping import TerminalParser
from stampede_rt.values.timeline import parse_duration
from stampede_rt_runtime.identity import Role

DESCRIPTION = "make the authority of a cluster and the certificates of its parts, and show their contents"
DEFAULT_FOLDER = Path("certs")
AUTHORITY_DAYS, CERTIFICATE_DAYS = 3650, 365


def parser_of(runs: Mapping[str, Callable[[argparse.Namespace], Any]]) -> argparse.ArgumentParser:
    """Return the parser. The parser names the function of `runs` to call for each verb."""
    parser = TerminalParser(prog="stampede certs", description=DESCRIPTION, allow_abbrev=False)
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    for add_verb in (_add_init, _add_issue, _add_renew, _add_revoke, _add_show):
        add_verb(verbs)
    for name, verb in verbs.choices.items():
        verb.set_defaults(run=runs[name])
        add_output(verb)
    return parser


def _add_init(verbs: Any) -> None:
    init = verbs.add_parser("init", help="make the cluster's authority in a folder that only this user may open")
    init.add_argument(
        "folder", nargs="?", type=Path, default=DEFAULT_FOLDER, metavar="DIR", help="the new folder; default: certs"
    )
    init.add_argument("--cluster", default="stampede", metavar="NAME", help="the cluster's name; default: stampede")
    init.add_argument(
        "--days",
        type=_days,
        default=AUTHORITY_DAYS,
        metavar="N",
        help=f"the authority is valid for N days; default: {AUTHORITY_DAYS}",
    )


def _add_issue(verbs: Any) -> None:
    one = verbs.add_parser("issue", help="make the certificate of one part, or renew it")
    one.add_argument(
        "--dir", type=Path, default=DEFAULT_FOLDER, metavar="DIR", help="the authority's folder; default: certs"
    )
    one.add_argument("--name", required=True, help="the part's name: a supernode's --id, a host's --name")
    one.add_argument("--role", required=True, choices=[str(role) for role in Role], help="the part of the cluster")
    one.add_argument(
        "--address",
        nargs="+",
        action="extend",
        default=[],
        metavar="HOST",
        help="names and IP addresses at which a service is called; default: this machine's name and localhost",
    )
    one.add_argument("--out", type=Path, metavar="DIR", help="write the files to DIR; default: the authority's folder")
    lifetime = one.add_mutually_exclusive_group()
    lifetime.add_argument(
        "--days", type=_days, metavar="N", help=f"the certificate is valid for N days; default: {CERTIFICATE_DAYS}"
    )
    lifetime.add_argument("--ttl", type=_ttl, metavar="DURATION", help="valid for this time, such as 12h")


def _add_renew(verbs: Any) -> None:
    renew = verbs.add_parser("renew", help="make certificates anew: same parts, addresses and lifetimes, same files")
    renew.add_argument("files", nargs="+", type=Path, metavar="FILE", help="NAME.pem, with NAME.key beside it")
    renew.add_argument(
        "--dir", type=Path, default=DEFAULT_FOLDER, metavar="DIR", help="the authority's folder; default: certs"
    )


def _add_revoke(verbs: Any) -> None:
    revoke = verbs.add_parser("revoke", help="make all services refuse certificates permanently")
    revoke.add_argument(
        "credentials",
        nargs="*",
        metavar="FILE|SERIAL",
        help="certificates, or serial numbers; default: list the revoked ones",
    )
    revoke.add_argument("--url", metavar="HOST:PORT,...", help="front-ends; default $STAMPEDE_URL")


def _add_show(verbs: Any) -> None:
    show = verbs.add_parser("show", help="print the owners of certificates, and when they end")
    show.add_argument("files", nargs="+", type=Path, metavar="FILE")


def _days(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) <= 36500:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: 1 to 36500")
    return int(text)


def _ttl(text: str) -> timedelta:
    try:
        lifetime = timedelta(microseconds=parse_duration(text, "ttl") // 1000)
    except InvalidArgument as error:
        raise argparse.ArgumentTypeError(error.message) from error
    if not timedelta(minutes=1) <= lifetime <= timedelta(days=36500):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: 1 min to 36500 days")
    return lifetime
