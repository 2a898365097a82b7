"""Scenes from Python, without a file: a constructor for each keyword of the file format, and `make_scene`.

    make_scene(
        build.camera("eye", pixeldim=(640, 480), viewpoint=(0, 0, 5), lookat=(0, 0, 0), fov=40),
        build.light("lamp", location=(2, 4, 3), emissivity=(1, 1, 1)),
        build.material("glass", ior=1.5, alpha=1),
        build.sphere("ball", material="glass", center=(0, 0, 0), radius=1),
    )

The constructors follow the table of blocks: `help(build.sphere)` tells what a sphere takes. Values are numbers, rows of
numbers or JAX arrays; what is traced is not checked.
"""

import dataclasses
import inspect
import operator
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import DTypeLike

from raytrace_jax.errors import SceneError
from raytrace_jax.scene.assembly import assemble
from raytrace_jax.scene.block_kinds import BLOCK_KINDS, SETTINGS
from raytrace_jax.scene.description import Description
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute, BlockKind, DerivedDefault, is_name
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.values import as_array, floating, is_traced
from raytrace_jax.util.text import quoted


def make_scene(*blocks: Description, dtype: DTypeLike | None = None, model: ModelName | None = None) -> Scene:
    """The scene of blocks that the constructors of this module describe.

    Args:
        blocks: one camera, at most one background and one block of settings, and any number of lights, textures,
            materials and shapes, in any order.
        dtype: floating dtype of the scene's arrays; None means JAX's default.
        model: the shading model with which the scene is rendered; its defaults fill in what a block leaves out. None
            is the model of the settings, else `classic`.

    Raises:
        SceneError: the blocks do not make a scene, or a value is not allowed in a file.
        TypeError: `dtype` is not a floating type, or something is no block.
    """
    float_dtype = floating(dtype)
    settings = [block for block in blocks if isinstance(block, Description) and block.keyword == SETTINGS]
    known = model or next((block.values.get("model") for block in settings), None) or "classic"
    described = (_checked(block, float_dtype, known) for block in blocks)
    return assemble(described, float_dtype, model, SceneError)


@dataclasses.dataclass(frozen=True)
class PythonOrigin:
    """Where a block of a program was described: its errors name the block."""

    whole: str = "scene"
    folder: Path = Path()
    wants_relative_paths: bool = False

    def is_there(self, part: str) -> str:
        """Blocks of a program have no lines."""
        return "comes before it"

    def unclosed(self, block: str) -> str:
        """Python itself sees to brackets."""
        return ""

    def error(self, part: str, message: str) -> SceneError:
        """The error with this message."""
        return SceneError(message)


def _constructor(keyword: str) -> Callable[..., Description]:
    """The function that describes a block of this keyword."""

    def construct(name: str, /, **values: Any) -> Description:
        if not is_name(name):
            message = f"expected a name for this {keyword}, got {quoted(name)}: a name is one word without braces."
            raise SceneError(message)
        block = Description(keyword, name, PythonOrigin())
        for attribute_name, value in values.items():
            block.admit(attribute_name)
            block.values[attribute_name] = value
        return block

    kinds = BLOCK_KINDS[keyword]
    construct.__name__ = construct.__qualname__ = keyword
    construct.__signature__ = _signature(kinds)  # pyright: ignore[reportFunctionMemberAccess]
    attributes = "\n\nor\n\n".join(map(_explanation, kinds))
    construct.__doc__ = f"Describe a {keyword} for `make_scene`, with these attributes:\n\n{attributes}"
    return construct


def _signature(kinds: tuple[BlockKind, ...]) -> inspect.Signature:
    """The signature: a name, then the attributes of all kinds by their names. What all kinds need has no default."""
    needed = set.intersection(*(set(kind.required("classic")) for kind in kinds))
    parameters = {"name": inspect.Parameter("name", inspect.Parameter.POSITIONAL_ONLY, annotation=str)}
    for attribute in (attribute for kind in kinds for attribute in kind.attributes):
        default = inspect.Parameter.empty if attribute.name in needed else _written(attribute.default)
        parameter = inspect.Parameter(attribute.name, inspect.Parameter.KEYWORD_ONLY, default=default)
        parameters.setdefault(attribute.name, parameter)
    return inspect.Signature(list(parameters.values()), return_annotation=Description)


def _explanation(kind: BlockKind) -> str:
    """What the attributes of a kind of block take, a line for each."""
    lines = []
    for attribute in kind.attributes:
        limit = f", {attribute.limit.wanted}" if attribute.limit else ""
        written = _written(attribute.default)
        words = attribute.default.words if isinstance(attribute.default, DerivedDefault) else written
        without = f"; optional, else {attribute.without}" if attribute.without else "; optional"
        default = f"; default {words}" if attribute.default else without if attribute.is_optional else ""
        models = "".join(f", {_written(other)} if {model}" for model, other in attribute.model_defaults.items())
        lines.append(f"    {attribute.describe()}{limit}{default}{models}")
    return "\n".join(lines)


def _written(
    default: tuple[float, ...] | DerivedDefault | str | None,
) -> tuple[float, ...] | float | str | None:
    """A default as one writes it: a single number is not in a row, and what follows from others is left out."""
    if isinstance(default, DerivedDefault):
        return None
    return default[0] if isinstance(default, tuple) and len(default) == 1 else default


_CONSTRUCTORS = {keyword: _constructor(keyword) for keyword in BLOCK_KINDS}


def __getattr__(keyword: str) -> Callable[..., Description]:
    if keyword not in _CONSTRUCTORS:
        raise AttributeError(f"module {__name__!r} has no attribute {keyword!r}; there are {', '.join(__dir__())}")
    return _CONSTRUCTORS[keyword]


def __dir__() -> list[str]:
    return ["make_scene", *_CONSTRUCTORS]


def _checked(block: Description, dtype: np.dtype, model: ModelName) -> Description:
    """The block with its values as arrays, complete."""
    if not isinstance(block, Description):
        raise TypeError(f"a scene is made of blocks such as build.camera(...), got {quoted(repr(block))}")
    values = {name: _value(block, _meant(block, name), value, dtype) for name, value in block.values.items()}
    checked = dataclasses.replace(block, values=values)
    checked.complete(dtype, model)
    return checked


def _meant(block: Description, name: str) -> Attribute:
    """Which of the things that an attribute can be its value is meant for; any if it is none of them."""
    attributes = block.admit(name)
    return next((attribute for attribute in attributes if attribute.takes(block.values[name])), attributes[0])


def _value(block: Description, attribute: Attribute, value: Any, dtype: np.dtype) -> Any:
    """One value of a block as the scene has it."""
    if value is None and attribute.is_optional:
        return None
    is_text = isinstance(value, str | os.PathLike)
    if attribute.kind == "file" and not is_text:
        return value  # Texels: they are checked where files are read.
    if attribute.is_text and is_text and (value in attribute.choices or not attribute.choices):
        return value
    if attribute.is_text:
        raise SceneError(f"in {block}, {attribute.describe()}, got {quoted(repr(value))}.")
    return _numbers(block, attribute, value, dtype)


def _numbers(block: Description, attribute: Attribute, value: Any, dtype: np.dtype) -> Any:
    """The numbers of an attribute."""
    try:
        if attribute.kind == "integer":
            value = [operator.index(number) for number in value] if attribute.components else operator.index(value)
        array = as_array(value, attribute.shape, dtype if attribute.kind == "number" else np.dtype(np.float64))
    except TypeError:
        raise SceneError(f"in {block}, {attribute.describe()}, got {quoted(repr(value))}.") from None
    except ValueError as reason:
        raise SceneError(f"in {block}, {attribute.name} {reason}.") from None
    violation = None if is_traced(array) else attribute.violation(np.asarray(array))
    if violation:
        raise SceneError(f"in {block}, {violation}, got {quoted(str(value))}.")
    return array
