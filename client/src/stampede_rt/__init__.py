"""Stampede RT: a distributed store of time-indexed live streams.

Producers put items into named channels under wall-clock time; consumers get whatever lies in a time interval, wait for
it, subscribe to it. Everything here blocks; `stampede_rt.aio` has the same surface with `await`.
"""

from __future__ import annotations

TYPE_CHECKING = False  # type checkers know better; `typing` itself takes as long to load as all of this

if TYPE_CHECKING:
    from stampede_rt.surface import *  # noqa: F403
    from stampede_rt.surface import __all__ as __all__
    from stampede_rt.surface import __version__ as __version__
else:

    def __getattr__(name):
        """A submodule, or a name of the surface, all of which is then loaded.

        Not before: gRPC and protobuf take 0.1 s of a processor, for which who needs a submodule alone does not pay, and
        which the command line spends where it can be interrupted.
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
