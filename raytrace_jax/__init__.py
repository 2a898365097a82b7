"""A differentiable Whitted ray tracer in JAX that reads the index of refraction off a picture.

The names below are imported when they are first used, so that the command line can answer `--help` without JAX.
"""

import ast
import functools
import importlib
from pathlib import Path
from typing import TYPE_CHECKING

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from . import optics as optics
    from .errors import ModelFileError as ModelFileError
    from .errors import ParameterError as ParameterError
    from .errors import PictureError as PictureError
    from .errors import RaytraceError as RaytraceError
    from .errors import RaytraceWarning as RaytraceWarning
    from .errors import SceneError as SceneError
    from .errors import SettingsError as SettingsError
    from .exchange.export import export_scene as export_scene
    from .exchange.mitsuba.load import import_scene as import_scene
    from .images.exr import read_exr as read_exr
    from .images.exr import write_exr as write_exr
    from .images.jpeg import jpeg_storage as jpeg_storage
    from .images.masks import read_mask as read_mask
    from .images.pictures import read_picture as read_picture
    from .images.png import write_png as write_png
    from .inverse.estimate import fit as fit
    from .inverse.options import FitOptions as FitOptions
    from .inverse.residual_function import PictureResidual as PictureResidual
    from .inverse.residual_function import covariance as covariance
    from .inverse.residual_function import make_residual as make_residual
    from .inverse.result import FitResult as FitResult
    from .optics import glass as glass
    from .report.films import write_derivatives as write_derivatives
    from .report.films import write_film as write_film
    from .scene import build as build
    from .scene.build import make_scene as make_scene
    from .scene.parameters import list_parameters as list_parameters
    from .scene.parameters import set_parameters as set_parameters
    from .scene.reader import load_scene as load_scene
    from .scene.reader import parse_scene as parse_scene
    from .scene.scene import Scene as Scene
    from .scene.writer import format_scene as format_scene
    from .tracer.film import Film as Film
    from .tracer.rendering import picture_derivatives as picture_derivatives
    from .tracer.rendering import render as render
    from .tracer.settings import RenderSettings as RenderSettings
    from .util.compilation import compiler_options as compiler_options
    from .util.session import enable_compile_cache as enable_compile_cache


@functools.cache
def _public() -> dict[str, str]:
    """The modules of the public names, relative to the package: what the block above says to type checkers."""
    tree = ast.parse(Path(__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: "." + (node.module or alias.name) for node in imports for alias in node.names}


def __getattr__(name: str) -> object:
    if name == "__all__":
        return ["__version__", *_public()]
    if name not in _public():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(_public()[name], __name__)
    if name == "optics":  # A room that is public as a whole, as is a module of another.
        return module
    is_module = name in ("build", "glass")
    value = importlib.import_module(f".{name}", module.__name__) if is_module else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({"__all__", *_public(), *(name for name in globals() if name.startswith("__"))})
