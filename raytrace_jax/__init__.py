"""A differentiable Whitted ray tracer in JAX that reads the index of refraction off a picture.

The names below are imported when they are first used, so that the command line can answer `--help` without JAX.
"""

import ast
import functools
import importlib
from pathlib import Path
from typing import TYPE_CHECKING

from raytrace_jax._version import __version__ as __version__

if TYPE_CHECKING:
    from raytrace_jax import optics as optics
    from raytrace_jax.errors import ModelFileError as ModelFileError
    from raytrace_jax.errors import ParameterError as ParameterError
    from raytrace_jax.errors import PictureError as PictureError
    from raytrace_jax.errors import RaytraceError as RaytraceError
    from raytrace_jax.errors import RaytraceWarning as RaytraceWarning
    from raytrace_jax.errors import SceneError as SceneError
    from raytrace_jax.errors import SettingsError as SettingsError
    from raytrace_jax.exchange.export import export_scene as export_scene
    from raytrace_jax.exchange.mitsuba.load import import_scene as import_scene
    from raytrace_jax.images.exr import read_exr as read_exr
    from raytrace_jax.images.exr import write_exr as write_exr
    from raytrace_jax.images.jpeg import jpeg_storage as jpeg_storage
    from raytrace_jax.images.masks import read_mask as read_mask
    from raytrace_jax.images.pictures import read_picture as read_picture
    from raytrace_jax.images.png import write_png as write_png
    from raytrace_jax.inverse.error_bars import covariance as covariance
    from raytrace_jax.inverse.estimate import fit as fit
    from raytrace_jax.inverse.options import FitOptions as FitOptions
    from raytrace_jax.inverse.residual_function import PictureResidual as PictureResidual
    from raytrace_jax.inverse.residual_function import make_residual as make_residual
    from raytrace_jax.inverse.result import FitResult as FitResult
    from raytrace_jax.report.films import write_derivatives as write_derivatives
    from raytrace_jax.report.films import write_film as write_film
    from raytrace_jax.scene import build as build
    from raytrace_jax.scene.build import make_scene as make_scene
    from raytrace_jax.scene.parameters import list_parameters as list_parameters
    from raytrace_jax.scene.parameters import set_parameters as set_parameters
    from raytrace_jax.scene.reader import load_scene as load_scene
    from raytrace_jax.scene.reader import parse_scene as parse_scene
    from raytrace_jax.scene.scene import Scene as Scene
    from raytrace_jax.scene.writer import format_scene as format_scene
    from raytrace_jax.tracer.derivatives import picture_derivatives as picture_derivatives
    from raytrace_jax.tracer.film import Film as Film
    from raytrace_jax.tracer.rendering import render as render
    from raytrace_jax.tracer.settings import RenderSettings as RenderSettings
    from raytrace_jax.util.compilation import compiler_options as compiler_options
    from raytrace_jax.util.session import enable_compile_cache as enable_compile_cache


@functools.cache
def _public() -> dict[str, str]:
    """The modules of the public names: what the block above says to type checkers."""
    tree = ast.parse(Path(__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module for node in imports for alias in node.names if node.module}


def __getattr__(name: str) -> object:
    if name == "__all__":
        return ["__version__", *_public()]
    if name not in _public():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = _public()[name]
    if name in ("optics", "build"):  # Modules that are public as a whole.
        return importlib.import_module(f"{module}.{name}")
    value = globals()[name] = getattr(importlib.import_module(module), name)
    return value


def __dir__() -> list[str]:
    return sorted({"__all__", *_public(), *(name for name in globals() if name.startswith("__"))})
