"""Finds the verb of a command line and runs it. Prints each error as a sentence, and returns an exit status."""

from __future__ import annotations

import argparse
import errno
import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.colours import styled
from stampede_rt.cli.exit_statuses import FAILED, INTERRUPTED, MISUSED
from stampede_rt.cli.interrupts import interruption
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.cli.verbs import SERVICE_VERBS, VERBS
from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.escaping import TerminalParser, escaped
from stampede_rt.version import VERSION

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


OUTPUT_ERRNOS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # a disk refuses the output


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit status."""
    try:
        return _run_and_flush(arguments)
    except StampedeError as error:
        if interruption.requested:  # Ctrl-C has closed the connection of the command
            return INTERRUPTED
        print(f"{styled('stampede:', 'red', sys.stderr)} {escaped(error.message)}", file=sys.stderr)
        return MISUSED if isinstance(error, InvalidArgument) else FAILED
    except BrokenPipeError:  # the program that reads the output has ended
        _drop_output()
        return 0
    except Exception as error:
        if interruption.requested:
            return INTERRUPTED
        if isinstance(error, OSError) and error.errno in OUTPUT_ERRNOS:
            _drop_output()
            print(f"stampede: the output cannot be written: {error.strerror}", file=sys.stderr)
            return FAILED
        if os.environ.get("STAMPEDE_DEBUG"):
            raise
        if isinstance(error, UnicodeEncodeError):  # a name or text of the command line goes into a message
            print("stampede: an argument is not text in UTF-8; only a payload may have other bytes", file=sys.stderr)
            return MISUSED
        what = escaped(f"{type(error).__name__}: {error}")
        print(f"stampede: a defect: {what}; set STAMPEDE_DEBUG=1 to see where", file=sys.stderr)
        return FAILED


def _run_and_flush(arguments: Sequence[str]) -> int:
    """Run one command, and flush its output.

    Raises an error if the disk is full, or if the reader of a pipe has ended. Without the flush the interpreter would
    raise this error at its end.
    """
    try:
        if arguments and arguments[0] in SERVICE_VERBS:
            status = _run_service(arguments[0], arguments[1:])
        else:
            status = _run_client(arguments)
    except SystemExit:  # after --help, --version, or wrong arguments
        sys.stdout.flush()
        raise
    sys.stdout.flush()
    return status


def _run_client(arguments: Sequence[str]) -> int:
    if arguments and arguments[0] not in VERBS and not arguments[0].startswith("-"):
        raise InvalidArgument(_unknown_verb(arguments[0]))
    parsed = parser_of(arguments[0] if arguments else None).parse_args(arguments)
    if "local" in parsed:
        from stampede_rt.cli.instants import show_local

        show_local(parsed.local)
    if "url" not in parsed:
        return int(parsed.run(parsed))
    return _run_in_context(lambda: parsed.run(parsed), has_url=bool(parsed.url))


def _unknown_verb(word: str) -> str:
    from difflib import get_close_matches

    near = get_close_matches(word, [*VERBS, *SERVICE_VERBS], n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"there is no verb {word}; {hint}`stampede --help` lists the verbs"


def _run_in_context(work: Callable[[], int], *, has_url: bool) -> int:
    from stampede_rt.cli.contexts import context_applied

    with context_applied(os.environ, has_url=has_url):
        return int(work())


def _drop_output() -> None:
    """Drop the buffered output, so that the interpreter does not try to write it again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run_service(verb: str, arguments: Sequence[str]) -> int:
    # The imports are here and in _parser, not at the top, so that neither function loads the modules of the other one.
    from importlib.metadata import entry_points

    from stampede_rt.administration.options import ADMINISTRATIVE_VERBS

    if verb == "supernode" and arguments and arguments[0] in ADMINISTRATIVE_VERBS:
        from stampede_rt.cli.supernode import administer

        return _run_in_context(lambda: administer(arguments), has_url=_names_a_cluster(arguments))
    if verb == "host" and arguments and arguments[0] == "drain":
        from stampede_rt.cli.draining import drain

        return _run_in_context(lambda: drain(arguments), has_url=_names_a_cluster(arguments))
    found = [point for point in entry_points(group="stampede_rt.verbs") if point.name == verb]
    if not found:
        extra = verb if verb in ("demo", "bench", "web") else "server"
        print(
            f"stampede: `{verb}` is not installed here: it belongs to the extra [{extra}] of stampede-rt; install that "
            "extra as you installed stampede-rt, or run `make setup` in a clone of the repository",
            file=sys.stderr,
        )
        return FAILED
    return _load_and_run(found[0], arguments)


def _names_a_cluster(arguments: Sequence[str]) -> bool:
    return any(word.partition("=")[0] in ("--url", "--frontend", "--member") for word in arguments)


def _load_and_run(point: EntryPoint, arguments: Sequence[str]) -> int:
    verb = point.load()
    return int(verb(arguments))


def parser_of(verb: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of the command line, with only the arguments of `verb`.

    If `verb` is not a client's verb, the parser has all verbs, without their arguments. It then prints the help or an
    error.
    """
    parser, verbs = _parser()
    if verb in VERBS:
        _add_module(verbs, VERBS[verb][0])
    else:
        for name, (_, text) in VERBS.items():
            verbs.add_parser(name, help=text)
    return parser


def full_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line with all verbs of clients and all their arguments."""
    parser, verbs = _parser()
    for module in dict.fromkeys(module for module, _ in VERBS.values()):
        _add_module(verbs, module)
    return parser


def _parser() -> tuple[argparse.ArgumentParser, Any]:
    parser = TerminalParser(
        prog="stampede",
        description="Stampede RT: a distributed store of time-indexed live streams.",
        epilog="verbs that run parts of the system (each has --help):\n"
        + "\n".join(f"  {name:<10}{text}" for name, text in SERVICE_VERBS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"stampede {VERSION}")
    return parser, parser.add_subparsers(dest="verb", metavar="VERB", required=True, parser_class=VerbParser)


def _add_module(verbs: Any, module: str) -> None:
    """Add the verbs of a module of this package, with their arguments."""
    from importlib import import_module

    import_module(f"stampede_rt.cli.{module}").add_verbs(verbs)
