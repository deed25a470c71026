"""All targets by name."""

from __future__ import annotations

from tests.robustness.fuzz.parsers import directory, requests
from tests.robustness.fuzz.parsers.target import Target

BY_NAME: dict[str, Target] = {target.name: target for module in (requests, directory) for target in module.TARGETS}
