"""A differentiable Whitted ray tracer in JAX that reads the index of refraction off a picture.

The names below are imported when they are first used, so that the command line can answer `--help` without JAX.
"""

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from . import optics as optics
    from .derivatives import picture_derivatives as picture_derivatives
    from .film import Film as Film
    from .inverse.fit import fit as fit
    from .inverse.result import FitResult as FitResult
    from .modelfile import format_scene as format_scene
    from .modelfile import load_scene as load_scene
    from .modelfile import parse_scene as parse_scene
    from .parameters import get_parameter as get_parameter
    from .parameters import list_parameters as list_parameters
    from .parameters import set_parameters as set_parameters
    from .pictures import read_picture as read_picture
    from .plan import Plan as Plan
    from .plan import plan_render as plan_render
    from .render import render as render
    from .scene import Scene as Scene
    from .settings import RenderSettings as RenderSettings

_MODULE_OF = {
    "picture_derivatives": "derivatives",
    "Film": "film",
    "fit": "inverse.fit",
    "FitResult": "inverse.result",
    "format_scene": "modelfile",
    "load_scene": "modelfile",
    "parse_scene": "modelfile",
    "get_parameter": "parameters",
    "list_parameters": "parameters",
    "set_parameters": "parameters",
    "read_picture": "pictures",
    "Plan": "plan",
    "plan_render": "plan",
    "render": "render",
    "Scene": "scene",
    "RenderSettings": "settings",
}

_MODULES = ("optics",)
"""Modules that are themselves part of the package's front."""

__all__ = ["__version__", *_MODULE_OF, *_MODULES]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return importlib.import_module(f".{name}", __name__)
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    setattr(sys.modules[__name__], name, value)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF, *_MODULES})


class _Package(ModuleType):
    """Python stores an imported submodule in its package: the module `render` must not hide the function `render`."""

    def __setattr__(self, name: str, value: object) -> None:
        if name == "render" and isinstance(value, ModuleType):
            value = value.render
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
