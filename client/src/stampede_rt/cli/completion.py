"""`stampede completion`: the script with which a shell completes commands. tools/command_pages.py generates it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from stampede_rt.cli.verbs import VERBS

SCRIPTS = Path(__file__).with_name("completions")
SHELLS = ("bash", "zsh", "fish")
HOW = """To complete commands in every new shell:

  bash  stampede completion bash > ~/.local/share/bash-completion/completions/stampede
  zsh   stampede completion zsh > ~/.zfunc/_stampede   (a folder of $fpath, before compinit)
  fish  stampede completion fish > ~/.config/fish/completions/stampede.fish
"""


def add_verbs(subparsers: Any) -> None:
    """Add the verb `completion`. It loads no other module of the client: shells may run it at their start."""
    text = VERBS["completion"][1]
    verb = subparsers.add_parser(
        "completion",
        help=text,
        description=text,
        epilog=HOW,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verb.add_argument("shell", choices=SHELLS, help="the shell")
    verb.set_defaults(run=run_completion)


def run_completion(arguments: argparse.Namespace) -> int:
    """Print the script."""
    sys.stdout.write((SCRIPTS / f"stampede.{arguments.shell}").read_text(encoding="utf-8"))
    return 0
