"""`python -m ... MODULE TARGET OPTION...` runs one target of a module under atheris, with the options of libFuzzer.

Atheris instruments the code that this module imports, and not the code of the other targets. It does not instrument the
generated messages either: that takes a minute, and protobuf parses in C anyway.
"""

from __future__ import annotations

import pkgutil
import sys
from importlib import import_module

import stampede_rt.v1

INSTRUMENTED = ["stampede_rt", "stampede_rt_channel_host", "stampede_rt_supernode", "stampede_rt_runtime"]


def fuzz(module: str, name: str, options: list[str]) -> None:
    """Run the fuzzer. Never returns."""
    import atheris

    for one in pkgutil.iter_modules(stampede_rt.v1.__path__, "stampede_rt.v1."):
        import_module(one.name)
    with atheris.instrument_imports(include=INSTRUMENTED):
        targets = import_module(module).TARGETS
    target = next(one for one in targets if one.name == name)
    atheris.Setup([sys.argv[0], *options], target)
    atheris.Fuzz()


if __name__ == "__main__":
    fuzz(sys.argv[1], sys.argv[2], sys.argv[3:])
