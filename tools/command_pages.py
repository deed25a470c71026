"""Generate the completion scripts and the man page from the parsers of all verbs; with --check tell whether they are up
to date.

shtab writes the scripts: it is the only maintained library that writes static scripts for bash, zsh and fish from
argparse. argparse-manpage writes the man page. Users need neither of them.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest.mock import patch

import shtab
from argparse_manpage.manpage import Manpage

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = ROOT / "client/src/stampede_rt/cli/completions"
MAN_PAGE = ROOT / "client/man/stampede.1"
SHELLS = ("bash", "zsh", "fish")
WIDTH = "100"  # the columns of a usage in the man page
USAGE = re.compile(r"^# Usage:\n(?:# .*\n)+", re.MULTILINE)
PLACE = "# `stampede completion --help` says where to put this script.\n"
COMPLETED = {"FILE": shtab.FILE, "OUT": shtab.FILE, "PATH": shtab.FILE, "FOLDER": shtab.DIRECTORY}
ENVIRONMENT = {
    "STAMPEDE_URL": "HOST:PORT of the front-ends, comma-separated, unless --url names them. Default: localhost:7580.",
    "STAMPEDE_CONTEXT": "The saved context for this command; see stampede context.",
    "STAMPEDE_SECRET_FILE": "The file of the secret or token. Default: ~/.config/stampede/secret.",
    "STAMPEDE_TLS_CA, STAMPEDE_TLS_CERTIFICATE, STAMPEDE_TLS_KEY": "The files of the certificates.",
    "NO_COLOR": "If it is set and not empty, no output has colours.",
    "TZ": "The time zone of --local, and of times without a zone.",
    "STAMPEDE_DEBUG": "If it is set, a defect prints where it is.",
}


class _ParserCaptured(BaseException):
    """Carries the parser that a command was about to use."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.parser = parser


def captured(main: Callable[[list[str]], object], words: list[str]) -> argparse.ArgumentParser:
    """Return the parser that `main` uses for `words`, without running the command."""

    def stop(parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        raise _ParserCaptured(parser)

    with patch.object(argparse.ArgumentParser, "parse_known_args", stop):
        try:
            main(words)
        except _ParserCaptured as caught:
            return caught.parser
    raise SystemExit(f"{main} has used no parser")


def command_parser() -> argparse.ArgumentParser:
    """Return one parser with all verbs: the verbs of clients, and the verbs that run parts of the system."""
    from stampede_rt.cli.commands import full_parser
    from stampede_rt.cli.draining import drain
    from stampede_rt.cli.supernode import administer
    from stampede_rt.cli.verbs import SERVICE_VERBS
    from stampede_rt_supernode.joining.preparing import prepare

    parser = full_parser()
    parser.epilog = None
    mains = {point.name: point.load() for point in entry_points(group="stampede_rt.verbs")}
    for verb, text in SERVICE_VERBS.items():
        own = captured(mains[verb], [])
        for further in {"host": (drain,), "supernode": (administer, prepare)}.get(verb, ()):
            _add_verbs(own, captured(further, ["x"]))
        _add_verb(_verbs_of(parser), verb, text, own)
    return parser


def _verbs_of(parser: argparse.ArgumentParser) -> Any:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return action
    return parser.add_subparsers(metavar="VERB")


def _add_verbs(parser: argparse.ArgumentParser, other: argparse.ArgumentParser) -> None:
    found = _verbs_of(other)
    texts = {one.dest: one.help or "" for one in found._choices_actions}
    for name, verb in found.choices.items():
        _add_verb(_verbs_of(parser), name, texts.get(name, ""), verb)


def _add_verb(verbs: Any, name: str, text: str, parser: argparse.ArgumentParser) -> None:
    verbs.add_parser(name, help=text, add_help=False)
    verbs.choices[name] = parser
    parser.description = parser.description or text


def scripts(parser: argparse.ArgumentParser) -> dict[Path, str]:
    """Return the text of each completion script. shtab's advice about its place would contradict the command's help."""
    return {
        SCRIPTS / f"stampede.{shell}": re.sub(USAGE, PLACE, shtab.complete(parser, shell), count=1) for shell in SHELLS
    }


def man_page(parser: argparse.ArgumentParser) -> str:
    """Return the man page of all verbs, with the exit statuses and the variables of the environment."""
    from stampede_rt.cli.exit_statuses import EXIT_STATUSES
    from stampede_rt.version import VERSION

    facts = {
        "project_name": "Stampede RT",
        "description": "a distributed store of time-indexed live streams",
        "date": f"release {VERSION}",  # a date would change with each day
        "version": VERSION,
        "manual_title": "Commands",
    }
    page = str(Manpage(parser, _data=facts, format="single-commands-section")).rstrip()
    statuses = {str(status): text for status, text in EXIT_STATUSES.items()}
    return page + _section("EXIT STATUS", statuses) + _section("ENVIRONMENT", ENVIRONMENT) + "\n"


def _section(title: str, entries: Mapping[str, str]) -> str:
    lines = [f"\n.SH {title}"]
    for name, text in entries.items():
        lines += [".TP", f"\\fB{name}\\fR", text.replace("-", "\\-")]
    return "\n".join(lines)


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Mark the arguments that are files, so that shells complete them."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                _complete_files(verb)
        elif action.metavar in COMPLETED:
            action.complete = COMPLETED[action.metavar]  # type: ignore[attr-defined,index]


def main() -> int:
    """Generate, or with --check compare."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--check", action="store_true")
    check = options.parse_args().check
    os.environ["COLUMNS"] = WIDTH
    parser = command_parser()
    _complete_files(parser)
    made = scripts(parser) | {MAN_PAGE: man_page(parser)}
    stale = [path for path, text in made.items() if not path.is_file() or path.read_text() != text]
    for path in stale:
        if check:
            print(f"{path.relative_to(ROOT)} differs from the text that its source generates; run: make stubs")
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(made[path])
    return 1 if stale and check else 0


if __name__ == "__main__":
    sys.exit(main())
