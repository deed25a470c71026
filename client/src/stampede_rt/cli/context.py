"""`stampede context ...`: saves the addresses of clusters and the files of their credentials, and chooses one."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stampede_rt.administration.output_forms import add_output
from stampede_rt.cli.contexts import CHOICE, NAME, VARIABLES, Contexts, write_private
from stampede_rt.cli.output import print_done, print_rows
from stampede_rt.cli.standard_input import read_all
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.cli.verbs import VERBS
from stampede_rt.errors import InvalidArgument

SECRET_BYTES_MAX = 4096


def add_verbs(subparsers: Any) -> None:
    """Add the noun of this module and its verbs."""
    text = VERBS["context"][1]
    noun = subparsers.add_parser("context", help=text, description=text)
    verbs = noun.add_subparsers(dest="context_verb", metavar="VERB", required=True, parser_class=VerbParser)
    add = _named_verb(verbs, "add", "save a context, or replace it", run_add)
    add.add_argument("--url", required=True, metavar="HOST:PORT", help="front-ends, comma-separated")
    add.add_argument(
        "--secret-file", metavar="FILE", help="the file of the secret or token; -: keep the secret from standard input"
    )
    for name, what in (("ca", "certificate authority"), ("certificate", "own certificate"), ("key", "own key")):
        add.add_argument(f"--tls-{name}", metavar="FILE", help=f"the file of the {what}")
    _named_verb(verbs, "use", "choose the context for all later commands", run_use)
    _named_verb(verbs, "rm", "forget a context", run_rm)
    for name, text, run in (
        ("ls", "list the saved contexts", run_ls),
        ("none", "choose no context: commands use $STAMPEDE_URL, or localhost:7580", run_none),
    ):
        _verb(verbs, name, text, run)


def _verb(verbs: Any, name: str, text: str, run: Callable[[argparse.Namespace], int]) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    add_output(parser)
    return parser


def _named_verb(verbs: Any, name: str, text: str, run: Callable[[argparse.Namespace], int]) -> argparse.ArgumentParser:
    parser = _verb(verbs, name, text, run)
    parser.add_argument("name", metavar="NAME", help="the context's name")
    return parser


def run_add(arguments: argparse.Namespace) -> int:
    """Save a context. Choose it, too, if no other context is chosen."""
    from stampede_rt.cluster.addresses import parse_addresses

    if not NAME.fullmatch(arguments.name):
        raise InvalidArgument(f"the context name {arguments.name!r} is not allowed; use letters, digits, '.', '_', '-'")
    parse_addresses(arguments.url)
    contexts = Contexts.load(os.environ)
    fields = {"url": arguments.url}
    if arguments.secret_file == "-":
        path = contexts.secret_path(arguments.name)
        write_private(path, _secret_of_stdin())
        arguments.secret_file = str(path)
    for field in ("secret_file", "tls_ca", "tls_certificate", "tls_key"):
        if getattr(arguments, field) is not None:
            fields[field] = _existing_file(getattr(arguments, field))
    contexts.by_name[arguments.name] = fields
    contexts.current = contexts.current or arguments.name
    contexts.save()
    chosen = contexts.current == arguments.name
    text = "is chosen" if chosen else f"is saved; `stampede context use {arguments.name}` chooses it"
    done = {"context": arguments.name, "url": arguments.url, "chosen": chosen}
    print_done(done, f"context {arguments.name} {text}", arguments.output)
    return 0


def _secret_of_stdin() -> bytes:
    wrong = f"standard input has no secret, or more than {SECRET_BYTES_MAX} bytes"
    secret = read_all(SECRET_BYTES_MAX, wrong)
    if not secret.strip():
        raise InvalidArgument(wrong)
    return secret


def _existing_file(name: str) -> str:
    path = Path(name).absolute()
    if not path.is_file():
        raise InvalidArgument(f"there is no file {name!r}; a context names files that exist")
    return str(path)


def run_use(arguments: argparse.Namespace) -> int:
    """Choose a context."""
    contexts = Contexts.load(os.environ)
    url = contexts.named(arguments.name)["url"]
    contexts.current = arguments.name
    contexts.save()
    done = {"context": arguments.name, "url": url, "chosen": True}
    print_done(done, f"commands now use {arguments.name} at {url}", arguments.output)
    for variable in (CHOICE, "STAMPEDE_URL"):
        if os.environ.get(variable):
            print(f"stampede: ${variable} is set, and overrides the context; unset it", file=sys.stderr)
    return 0


def run_none(arguments: argparse.Namespace) -> int:
    """Choose no context."""
    contexts = Contexts.load(os.environ)
    contexts.current = None
    contexts.save()
    print_done({"context": None, "chosen": False}, "commands now use no context", arguments.output)
    return 0


def run_rm(arguments: argparse.Namespace) -> int:
    """Forget a context, and delete the secret file that `context add` made for it. Files that the user named stay."""
    contexts = Contexts.load(os.environ)
    contexts.named(arguments.name)
    del contexts.by_name[arguments.name]
    contexts.current = None if contexts.current == arguments.name else contexts.current
    contexts.save()
    contexts.secret_path(arguments.name).unlink(missing_ok=True)
    done = {"context": arguments.name, "forgotten": True}
    print_done(done, f"context {arguments.name} is forgotten", arguments.output)
    return 0


def run_ls(arguments: argparse.Namespace) -> int:
    """List the contexts: addresses and paths, and no secrets."""
    contexts = Contexts.load(os.environ)
    current = os.environ.get(CHOICE) or contexts.current
    rows = []
    for name, fields in sorted(contexts.by_name.items()):
        mark: Any = name == current if arguments.output != "table" else "*" if name == current else None
        rows.append({"current": mark, "context": name} | {field: fields.get(field) for field in VARIABLES})
    if arguments.output == "table":
        kept = [field for field in VARIABLES if any(row[field] for row in rows)]
        rows = [{name: row[name] for name in ("current", "context", *kept)} for row in rows]
    print_rows(
        rows, arguments.output, none="no context is saved; `stampede context add NAME --url HOST:PORT` saves one"
    )
    return 0
