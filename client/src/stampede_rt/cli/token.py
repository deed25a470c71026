"""`stampede token issue|revoke`: tokens for clients without certificates and without a shared secret."""

from __future__ import annotations

import argparse
import base64
import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from stampede_rt.cli.arguments import add_verb, checked
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import print_behind, print_done, print_facts
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.errors import InvalidArgument, PermissionDenied, StampedeError
from stampede_rt.escaping import escaped
from stampede_rt.values.timeline import parse_duration

ROLES = ("client", "operator")
TTL_NANOS_MAX = 30 * 86_400 * 10**9
TTL_DEFAULT = "1h"
SERIAL_DIGITS = 16


def add_verbs(subparsers: Any) -> None:
    """Add the noun of this module and its verbs."""
    text = "tokens that prove a client's name and roles for a while"
    noun = subparsers.add_parser("token", help=text, description=text)
    verbs = noun.add_subparsers(dest="token_verb", metavar="VERB", required=True, parser_class=VerbParser)
    issue = add_verb(verbs, "issue", "make a token; for operators and holders of the cluster's secret", run_issue)
    issue.add_argument("name", metavar="NAME", help="the client's name, which rules of access use")
    issue.add_argument("--role", action="append", choices=ROLES, help="may be repeated; default client")
    issue.add_argument(
        "--ttl",
        type=checked(_ttl),
        default=TTL_DEFAULT,
        metavar="DURATION",
        help="the time for which the token is valid, at most 30 days; default 1h",
    )
    revoke = add_verb(verbs, "revoke", "revoke a token permanently: all services refuse it from then on", run_revoke)
    revoke.add_argument(
        "token",
        metavar="SERIAL|FILE",
        help="the token's serial number, which `token issue` printed, or the token's file",
    )
    issue.add_argument("--out", type=Path, metavar="FILE", help="write the token to FILE, which only you can read")


def _ttl(text: str) -> int:
    nanos = parse_duration(text, "--ttl")
    if not 0 < nanos <= TTL_NANOS_MAX:
        raise InvalidArgument(f"{text!r} cannot be used; write a duration above 0, at most 30 days")
    return nanos


def run_issue(arguments: argparse.Namespace) -> int:
    """Make a token, and print it or write it to a file."""
    from stampede_rt.administration.running_cluster import reached  # gRPC takes 0.1 s to load

    with _new_file(arguments.out) as file, reached(arguments.url, None) as cluster:
        made = cluster.issue_client_token(arguments.name, arguments.role or ["client"], valid_nanos=arguments.ttl)
        if file is not None:
            file.write(made.token + "\n")
        print_behind(cluster.parts_behind(made.version))
    end_text = instant_text(made.valid_until_unix_nano // 10**9 * 10**9).replace(".000000000", "")
    for_people = arguments.output == "table"
    valid_until = end_text if for_people else made.valid_until_unix_nano
    facts = {"name": arguments.name, "serial": made.serial, "valid_until": valid_until}
    if arguments.out is None:
        if for_people:
            print(made.token)  # without other text, so that a script can take it
            print(f"serial {made.serial} (for `stampede token revoke`), valid until {end_text}", file=sys.stderr)
        else:
            print_facts({**facts, "token": made.token}, arguments.output)
        return 0
    print_facts({**facts, "file": str(arguments.out)}, arguments.output)
    if for_people:
        print(f"\nThe client sets STAMPEDE_SECRET_FILE={arguments.out}.")
    return 0


def run_revoke(arguments: argparse.Namespace) -> int:
    """Revoke a token."""
    from stampede_rt.administration.running_cluster import reached

    serial = _serial_of(arguments.token)
    with reached(arguments.url, None) as cluster:
        version = cluster.revoke(serial)
        text = f"{serial} is revoked: its open streams end, and services refuse it from now on."
        print_done({"serial": serial, "revoked": True}, text, arguments.output)
        try:
            print_behind(cluster.parts_behind(version))
        except PermissionDenied as error:  # the operator has revoked its own token
            print(f"stampede: {escaped(error.message)}", file=sys.stderr)
    return 0


def _serial_of(text: str) -> str:
    """Return a token's serial number. `text`: this number, or the path of the token's file. Raises StampedeError."""
    try:
        return _serial_in(Path(text).read_text()) if Path(text).is_file() else _checked(text)
    except (OSError, ValueError, KeyError, TypeError):
        raise StampedeError(
            f"{text!r} is neither the file of a token nor the serial number of a token, which has {SERIAL_DIGITS} "
            "hexadecimal digits; revoke certificates with `stampede certs revoke`"
        ) from None


def _serial_in(token: str) -> str:
    """The serial number in the second part of a token. Raises ValueError, KeyError or TypeError."""
    body = token.strip().split(".")[1:2]
    return _checked(json.loads(base64.urlsafe_b64decode(body[0] + "==" if body else ""))["serial"])


def _checked(serial: str) -> str:
    if re.fullmatch(rf"[0-9a-f]{{{SERIAL_DIGITS}}}", serial.lower()) is None:
        raise ValueError(serial)
    return serial.lower()


@contextmanager
def _new_file(path: Path | None) -> Iterator[TextIO | None]:
    """Yield a new file for a token; None if no path is given. Removes the file if the block fails.

    The file is made before the token, so that no token is made if the file cannot be written. Never overwrites a file,
    because that file may hold another secret.
    """
    if path is None:
        yield None
        return
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            try:
                yield file
            except BaseException:
                path.unlink(missing_ok=True)
                raise
    except OSError as error:
        raise StampedeError(f"{path} cannot be written: {error.strerror}; name a new file with --out") from error
