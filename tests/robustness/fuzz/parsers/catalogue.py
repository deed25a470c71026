"""All parsers that the fuzzer calls (`Target`), by name."""

from __future__ import annotations

from typing import Any

from tests.robustness.fuzz.parsers import access, answers, command_line, directory, files, recordings, requests, texts
from tests.robustness.fuzz.parsers.target import Target

MODULES: tuple[Any, ...] = (requests, directory, texts, command_line, files, recordings, answers, access)
BY_NAME: dict[str, Target] = {target.name: target for module in MODULES for target in module.TARGETS}
MODULE_OF: dict[str, str] = {target.name: module.__name__ for module in MODULES for target in module.TARGETS}
"""The module of each target."""
