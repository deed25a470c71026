"""Check that docstrings, comments and names have a noun: not "What was collected", but "the collected items".

The explanation of an argument needs its noun, too, as in "`epoch`: the epoch of the channel". The rule is under "Plain
prose" in CONTRIBUTING. A docstring may be a question ("Who leads?"). In texts and names the check also refuses the
words of TWO_MEANINGS. No docstring may begin with "As `name`": say what the function does. No variable or function may
have one of the VAGUE_NAMES, with or without an underscore before it. No variable may have a name such as `of_queues`,
which lacks its noun. A program cannot check the other rules.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("client/src", "services", "benchmarks", "demos", "deploy", "tools", "web", "tests")
GENERATED = {"v1", "_sync"}  # the stubs, and the client that is derived from _async/

FIRST_WORDS = re.compile(r"(What|Whatever|Who|Whoever|Whose|Those|Of|Earlier(?=,)|As(?= `))\b(?![^.:]*\?)")
# A name must say what the variable holds, or what the function does.
VAGUE_NAMES = {
    "again", "asked", "brought", "came", "come", "coming", "go_on", "goes_on", "hear", "heard", "is_level", "lacks",
    "news", "said", "strays", "told",
}  # fmt: skip
NAMES_WITHOUT_NOUN = re.compile(r"\b_*of_\w+")
PHRASES = re.compile(r"\b([Ww]hoever|by the book)\b|(`: of)\b|(`: (?:the|its) \w+'s)[.,;]")
# The first words of a comment: a comment at the end of a line, or the first line of other comments.
COMMENT_WORDS = re.compile(r"(?:^|  )(?:#:?|//) ([Ww]hat|[Ww]ho|[Ww]hoever|[Ww]hatever|[Ww]hose|[Tt]hose|[Oo]f)\b")
PROTO_WORDS = re.compile(r"^// (Which|It|They)\b")
# Words for "immediately", and for "at the same time". They may stand on two lines of a text.
TWO_MEANINGS = re.compile(r"(?<![a-z])at(?:_|\s+(?:# |// )?)?once(?![a-z])", re.IGNORECASE)
TEST_NAMES = re.compile(
    r"test_(what|whatever|who|whose|why|that|those_who|there|(?:one|all|nothing)_(?:that|who|of|else|but))_"
    r"|test_\w*_(whoever|whatever|whom|what|those)(?:_|$)"
)


def complaints(path: str, source: str) -> Iterator[str]:
    """Yield a line for each docstring, name of a test and comment that breaks the rule."""
    yield from complaints_about_lines(path, source)
    tree = ast.parse(source)
    for name, line in _assigned_names(tree) if any(map(_is_vague, re.findall(r"\w+", source))) else ():
        if _is_vague(name):
            yield f'{path}:{line}: name the thing that "{name}" holds, or what it does'
    for name, line in _variables(tree) if NAMES_WITHOUT_NOUN.search(source) else ():
        if NAMES_WITHOUT_NOUN.fullmatch(name):
            yield f'{path}:{line}: name the thing that "{name}" holds'
    for node in _statements(tree):
        if found := _headless_words(node):
            line = getattr(node, "lineno", 1)
            yield f'{path}:{line}: name the noun instead of "{found}", see "Plain prose" in CONTRIBUTING.md'


def complaints_about_lines(path: str, source: str) -> Iterator[str]:
    """Yield a line for each comment that breaks the rule, and for each line with words of two meanings.

    In .proto files no comment may begin with "Which", "It" or "They", either.
    """
    former = ""
    for number, line in enumerate(map(str.strip, source.splitlines()), 1):
        continues = line.startswith(("#", "//")) and former.startswith(("#", "//"))
        found = COMMENT_WORDS.search(line) or (path.endswith(".proto") and PROTO_WORDS.match(line))
        if found and not continues:
            yield f'{path}:{number}: name the noun instead of "{found[1]}", see "Plain prose" in CONTRIBUTING.md'
        former = line
    for words in TWO_MEANINGS.finditer(source):
        number = source.count("\n", 0, words.start()) + 1
        yield f'{path}:{number}: say "immediately" or "at the same time" instead of {words[0]!r}'


def _statements(parent: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements below a node. It leaves expressions out, because they are most of the nodes of a tree."""
    for name in ("body", "handlers", "orelse", "finalbody", "cases"):
        below = getattr(parent, name, ())
        for node in below if isinstance(below, list) else ():
            yield node
            yield from _statements(node)


def _is_vague(name: str) -> bool:
    return name.lstrip("_") in VAGUE_NAMES


def _variables(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield the names and lines of all variables and attributes that a module defines, except arguments."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name, node.lineno


def _assigned_names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield the names and lines of all variables, attributes, arguments and functions that a module defines."""
    yield from _variables(tree)
    for node in ast.walk(tree):
        match node:
            case ast.arg(arg=name):
                yield name, node.lineno
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name, node.lineno
            case ast.ExceptHandler(name=str(name)):
                yield name, node.lineno


def _headless_words(node: ast.AST) -> str | None:
    match node:
        case ast.Expr(value=ast.Constant(value=str(text))):
            found = FIRST_WORDS.match(text) or PHRASES.search(text)
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
            found = TEST_NAMES.match(name)
        case _:
            found = None
    return found and next(filter(None, found.groups()))


def modules() -> Iterable[Path]:
    """Yield the modules that people write."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if GENERATED.isdisjoint(path.parts) and ".venv" not in path.parts:
                yield path


def main() -> int:
    """Print the docstrings, names and comments that break the rule. Returns the exit status."""
    found = [line for path in modules() for line in complaints(str(path.relative_to(ROOT)), path.read_text())]
    for path in sorted((ROOT / "proto").rglob("*.proto")):
        found += complaints_about_lines(str(path.relative_to(ROOT)), path.read_text())
    for line in found:
        print(line)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
