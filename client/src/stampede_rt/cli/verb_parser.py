"""The parser of one verb of the command line."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from itertools import takewhile
from typing import Any, NoReturn

from stampede_rt.escaping import TerminalParser


class VerbParser(TerminalParser):
    """The parser of one verb. It allows options between the arguments, and refuses unknown arguments."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._negative_number_matcher = re.compile(r"-\.?\d")  # a value such as -1h is not an option

    _intermixed = False  # whether `parse_known_intermixed_args` runs, which calls `parse_known_args` again

    def parse_known_args(  # type: ignore[override]  # typeshed has an overload for each kind of namespace
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> Any:
        """Parse the verb's arguments. `parse_known_intermixed_args` calls this method again, for each of its passes."""
        if self._intermixed or self._subparsers is not None:
            # The parser of a noun, such as "queue", leaves the rest to the parsers of the noun's verbs.
            return super().parse_known_args(args, namespace)
        self._refuse_unknown_options(sys.argv[1:] if args is None else args)
        self._intermixed = True
        try:
            parsed, unknown = self.parse_known_intermixed_args(args, namespace)
        finally:
            self._intermixed = False
        if unknown:
            self._refuse(unknown)
        return parsed, unknown

    def _refuse_unknown_options(self, args: Sequence[str]) -> None:
        """Refuse unknown options before the values. An error about the value after such an option would mislead."""
        options = (word.partition("=")[0] for word in takewhile(lambda word: word != "--", args))
        unknown = [one for one in options if one.startswith("--") and not self._is_known(one)]
        if unknown:
            self._refuse(unknown)

    def _is_known(self, option: str) -> bool:
        return any(known.startswith(option) for known in self._option_string_actions)

    def _refuse(self, unknown: Sequence[str]) -> NoReturn:
        self.error(f"{self.prog} has no argument {' '.join(unknown)}; see {self.prog} --help")
