"""Finds the verb of a command line and runs it. Prints each error as a sentence, and returns an exit status."""

from __future__ import annotations

import argparse
import errno
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from stampede_rt.cli.interrupts import INTERRUPTED, interruption
from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.escaping import TerminalParser, escaped
from stampede_rt.version import VERSION

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

FAILED = 1  # the exit status of a command that failed
MISUSED = 2  # the exit status of a command with wrong arguments

OUTPUT_ERRNOS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # a disk refuses the output

VERB_MODULES = (
    "discovery", "hosts", "data", "group", "queue", "mailbox", "proxy", "rates", "top", "lag", "record", "replay",
    "export", "file", "doctor", "acl", "quota", "token",
)  # fmt: skip
"""The modules with the verbs of clients, in the order of the help."""

SERVICE_VERBS = {
    "dev": "run the whole system on this machine, in memory",
    "frontend": "run a front-end",
    "supernode": "run a supernode",
    "host": "run a channel host",
    "web": "serve a page that shows all streams on one time line",
    "certs": "make the certificates of a cluster",
    "demo": "run a demonstration on real media",
    "bench": "run a benchmark, such as the paper's figures",
}


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit status."""
    try:
        if arguments and arguments[0] in SERVICE_VERBS:
            status = _run_service(arguments[0], arguments[1:])
        else:
            parsed = _parser().parse_args(arguments)
            status = int(parsed.run(parsed))
        sys.stdout.flush()  # if the disk is full, the error comes here, and not when the interpreter ends
        return status
    except StampedeError as error:
        if interruption.asked:  # Ctrl-C has closed the connection of the command
            return INTERRUPTED
        print(f"stampede: {escaped(error.message)}", file=sys.stderr)
        return MISUSED if isinstance(error, InvalidArgument) else FAILED
    except BrokenPipeError:  # the program that reads the output has ended
        _drop_output()
        return 0
    except Exception as error:
        if interruption.asked:
            return INTERRUPTED
        if isinstance(error, OSError) and error.errno in OUTPUT_ERRNOS:
            _drop_output()
            print(f"stampede: the output cannot be written: {error.strerror}", file=sys.stderr)
            return FAILED
        if os.environ.get("STAMPEDE_DEBUG"):
            raise
        print(
            f"stampede: a defect: {type(error).__name__}: {error}; set STAMPEDE_DEBUG=1 to see where", file=sys.stderr
        )
        return FAILED


def _drop_output() -> None:
    """Drop the buffered output, so that the interpreter does not try to write it again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run_service(verb: str, arguments: Sequence[str]) -> int:
    # The imports are here and in _parser, not at the top, so that neither function loads the modules of the other one.
    from importlib.metadata import entry_points

    import stampede_rt.grpc_quiet  # noqa: F401  # before anything imports gRPC
    from stampede_rt.administration.options import ADMINISTRATIVE_VERBS

    if verb == "supernode" and arguments and arguments[0] in ADMINISTRATIVE_VERBS:
        from stampede_rt.cli.supernode import administer

        return administer(arguments)
    if verb == "host" and arguments and arguments[0] == "drain":
        from stampede_rt.cli.draining import drain

        return drain(arguments)
    found = [point for point in entry_points(group="stampede_rt.verbs") if point.name == verb]
    if not found:
        extra = verb if verb in ("demo", "bench", "web") else "server"
        print(
            f"stampede: `{verb}` is not installed here: it belongs to the extra [{extra}] of stampede-rt; install that "
            "extra from where stampede-rt came from, or run `make setup` in a clone of the repository",
            file=sys.stderr,
        )
        return FAILED
    return _load_and_run(found[0], arguments)


def _load_and_run(point: EntryPoint, arguments: Sequence[str]) -> int:
    verb = point.load()
    return int(verb(arguments))


def _parser() -> argparse.ArgumentParser:
    from importlib import import_module

    from stampede_rt.cli.arguments import VerbParser

    verbs = "\n".join(f"  {verb:<10}{text}" for verb, text in SERVICE_VERBS.items())
    parser = TerminalParser(
        prog="stampede",
        description="Stampede RT: a distributed store of time-indexed live streams.",
        epilog=f"verbs that run parts of the system (each has --help):\n{verbs}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"stampede {VERSION}")
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", required=True, parser_class=VerbParser)
    for name in VERB_MODULES:
        import_module(f"stampede_rt.cli.{name}").add_verbs(subparsers)
    return parser
