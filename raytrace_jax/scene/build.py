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

import inspect
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jax.typing import DTypeLike

from raytrace_jax.errors import SceneError
from raytrace_jax.scene.assemble import assemble, floating
from raytrace_jax.scene.rows import Description, Origin, describe
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import BlockType, DerivedDefault
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import BLOCK_TYPES, SETTINGS
from raytrace_jax.util.text import did_you_mean, listed, quoted


def make_scene(*blocks: Description, dtype: DTypeLike | None = None, model: ModelName | None = None) -> Scene:
    """The scene of blocks that the constructors of this module describe.

    Args:
        blocks: one camera, at most one background and one block of settings, and any number of lights, textures,
            materials and shapes, in any order.
        dtype, model: as for `reader.parse_scene`.

    Raises:
        SceneError: the blocks do not make a scene, or a value is not allowed in a file.
        TypeError: `dtype` is not a floating type, or something is no block.
    """
    float_dtype = floating(dtype)
    for block in blocks:
        if not isinstance(block, Description):
            raise TypeError(f"a scene is made of blocks such as build.camera(...), got {quoted(repr(block))}")
    settings_first = sorted(blocks, key=lambda block: block.keyword != SETTINGS)
    return assemble(settings_first, float_dtype, model, SceneError)


def scene_from_dict(
    values: Mapping[str, Any], *, folder: str | os.PathLike[str] = ".", dtype: DTypeLike | None = None
) -> Scene:
    """The scene of the values of `writer.scene_to_dict`.

    Args:
        values: `blocks`, and `model`, which may be missing.
        folder: where the paths of pictures begin.

    Raises:
        SceneError: the values are no scene.
    """
    rows = values.get("blocks") if isinstance(values, Mapping) else None
    if not isinstance(rows, (list, tuple)) or not all(isinstance(row, Mapping) for row in rows):
        raise SceneError('a scene is wanted as {"blocks": [{"block": "sphere", "name": "ball", ...}, ...]}.')
    unknown = sorted(set(values) - {"model", "blocks"})
    if unknown:
        raise SceneError(f"a scene has model and blocks, not {listed(unknown)}.")
    described = []
    for row in rows:
        keyword, name = row.get("block"), row.get("name")
        if keyword not in BLOCK_TYPES:
            guess = did_you_mean(str(keyword), BLOCK_TYPES)
            raise SceneError(f"there is no block {quoted(str(keyword))}.{guess} Blocks: {listed(BLOCK_TYPES)}.")
        if not isinstance(name, str):
            raise SceneError(f"a {keyword} has no name.")
        said = {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()}
        del said["block"], said["name"]
        described.append(describe(keyword, name, said, Origin(Path(folder))))
    return make_scene(*described, dtype=dtype, model=values.get("model"))


def _constructor(keyword: str) -> Callable[..., Description]:
    """The function that describes a block of this keyword."""

    def construct(name: str, /, **values: Any) -> Description:
        return describe(keyword, name, values, Origin())

    rows = BLOCK_TYPES[keyword]
    construct.__name__ = construct.__qualname__ = keyword
    construct.__signature__ = _signature(rows)  # pyright: ignore[reportFunctionMemberAccess]
    attributes = "\n\nor\n\n".join(map(_explanation, rows))
    construct.__doc__ = f"Describe a {keyword} for `make_scene`, with these attributes:\n\n{attributes}"
    return construct


def _signature(rows: tuple[BlockType, ...]) -> inspect.Signature:
    """The signature: a name, then the attributes of all types by their names. What all types need has no default."""
    needed = set.intersection(*(set(row.required("classic")) for row in rows))
    parameters = {"name": inspect.Parameter("name", inspect.Parameter.POSITIONAL_ONLY, annotation=str)}
    for attribute in (attribute for row in rows for attribute in row.attributes):
        default = inspect.Parameter.empty if attribute.name in needed else _written(attribute.default)
        parameter = inspect.Parameter(attribute.name, inspect.Parameter.KEYWORD_ONLY, default=default)
        parameters.setdefault(attribute.name, parameter)
    return inspect.Signature(list(parameters.values()), return_annotation=Description)


def _explanation(row: BlockType) -> str:
    """The attributes of a type of block and what they take, a line for each."""
    lines = []
    for attribute in row.attributes:
        limit = f", {attribute.limit.wanted}" if attribute.limit else ""
        written = _written(attribute.default)
        words = attribute.default.words if isinstance(attribute.default, DerivedDefault) else written
        without = f"; optional, else {attribute.without}" if attribute.without else "; optional"
        default = f"; default {words}" if attribute.default else without if attribute.is_optional else ""
        models = "".join(f", {_written(other)} if {model}" for model, other in attribute.model_defaults.items())
        lines.append(f"    {attribute.describe()}{limit}{default}{models}")
    return "\n".join(lines)


def _written(default: tuple[float, ...] | DerivedDefault | str | None) -> Any:
    """A default as one writes it: a single number is not in a row, and what follows from others is left out."""
    if isinstance(default, DerivedDefault):
        return None
    return default[0] if isinstance(default, tuple) and len(default) == 1 else default


_CONSTRUCTORS = {keyword: _constructor(keyword) for keyword in BLOCK_TYPES}


def __getattr__(keyword: str) -> Callable[..., Description]:
    if keyword not in _CONSTRUCTORS:
        raise AttributeError(f"module {__name__!r} has no attribute {keyword!r}; there are {', '.join(__dir__())}")
    return _CONSTRUCTORS[keyword]


def __dir__() -> list[str]:
    return ["make_scene", *_CONSTRUCTORS]
