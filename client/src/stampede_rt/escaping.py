"""Escapes control characters in the output of commands: arguments, names and errors come from other programs. Pure."""

from __future__ import annotations

import argparse
from typing import NoReturn


def escaped(text: str) -> str:
    r"""Return `text` as one line. Each character that is not printable becomes an escape, such as `\n` or `\x1b`.

    Names, attributes, content types, payloads and error texts come from other programs. Without escapes they could move
    the cursor, change the window's title, or forge lines of output.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text)


class TerminalParser(argparse.ArgumentParser):
    """A parser of arguments that escapes its error texts, because other programs may have written the arguments."""

    def error(self, message: str) -> NoReturn:
        """Print the usage and `message`, escaped, to standard error, and exit with status 2."""
        super().error(escaped(message))
