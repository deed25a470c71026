"""Stampede RT: a distributed store of time-indexed live streams.

A producer puts items with their times into named channels. A consumer gets the items of an interval, waits for them, or
subscribes to them. All calls here block; `stampede_rt.aio` has the same names with `await`.
"""

from __future__ import annotations

TYPE_CHECKING = False  # importing `typing` would take as long as the rest of this module

if TYPE_CHECKING:
    from stampede_rt.surface import *  # noqa: F403
    from stampede_rt.surface import __all__ as __all__
    from stampede_rt.surface import __version__ as __version__
else:

    def __getattr__(name):
        """Load the submodule `name`, or load the whole surface and return `name` from it.

        The package loads the surface late, because gRPC and protobuf take 0.1 s to load. A program that needs only one
        submodule does not load them. The command line loads them at a moment when Ctrl-C works.
        """
        from importlib import import_module
        from importlib.util import find_spec

        if find_spec(f"{__name__}.{name}") is not None:
            return import_module(f"{__name__}.{name}")
        surface = import_module(f"{__name__}.surface")
        if name == "__all__":
            return surface.__all__
        if name not in surface.__all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals().update({one: getattr(surface, one) for one in surface.__all__})
        return globals()[name]

    def __dir__():
        return sorted({*globals(), *__getattr__("__all__")})


del TYPE_CHECKING
