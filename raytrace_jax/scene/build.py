"""Scenes from Python, without a file: a constructor for each keyword of the file format, and `make_scene`.

    make_scene(
        build.camera("eye", pixeldim=(640, 480), viewpoint=(0, 0, 5), lookat=(0, 0, 0), fov=40),
        build.light("lamp", location=(2, 4, 3), emissivity=(1, 1, 1)),
        build.material("glass", ior=1.5, alpha=1),
        build.sphere("ball", material="glass", center=(0, 0, 0), radius=1),
    )

`help(build.sphere)` tells what a sphere takes. Values are numbers, rows of numbers or JAX arrays; what is traced is not
checked.
"""

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jax.typing import DTypeLike

from ..errors import SceneError
from ..util.files import StrPath
from ..util.text import did_you_mean, listed, quoted
from .rows import Description, assemble, describe, floating
from .scene import Scene
from .setting_words import ModelName
from .table import BLOCK_TYPES, SETTINGS


def make_scene(*blocks: Description, dtype: DTypeLike | None = None, model: ModelName | None = None) -> Scene:
    """The scene of blocks that the constructors of this module describe.

    Args:
        blocks: one camera or several, each with a film at most, at most one background and one block of settings, and
            any number of lights, textures, materials and shapes, in any order. The first camera is rendered.
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


def scene_from_dict(values: Mapping[str, Any], *, folder: StrPath = ".", dtype: DTypeLike | None = None) -> Scene:
    """The scene of the values of `writer.scene_to_dict`, of which `model` may be missing.

    The paths of pictures begin in `folder`. Raises SceneError for values that are no scene.
    """
    rows = values.get("blocks") if isinstance(values, Mapping) else None
    if not isinstance(rows, (list, tuple)) or not all(isinstance(row, Mapping) for row in rows):
        raise SceneError('a scene is wanted as {"blocks": [{"block": "sphere", "name": "ball", ...}, ...]}.')
    if unknown := sorted(set(values) - {"model", "blocks"}):
        raise SceneError(f"a scene has model and blocks, not {listed(unknown)}.")
    described = []
    for row in rows:
        keyword, name = row.get("block"), row.get("name")
        if keyword not in BLOCK_TYPES:
            guess = did_you_mean(str(keyword), BLOCK_TYPES)
            raise SceneError(f"there is no block {quoted(str(keyword))}.{guess} Blocks: {listed(BLOCK_TYPES)}.")
        said = {key: value for key, value in row.items() if key not in ("block", "name")}
        said = {key: tuple(value) if isinstance(value, list) else value for key, value in said.items()}
        described.append(describe(keyword, name, said, Path(folder)))
    return make_scene(*described, dtype=dtype, model=values.get("model"))


@functools.cache
def _constructor(keyword: str) -> Callable[..., Description]:
    """The function that describes a block of this keyword; it explains itself by the table."""

    def construct(name: str, /, **values: Any) -> Description:
        return describe(keyword, name, values)

    lines = []
    for row in BLOCK_TYPES[keyword]:
        lines.append("\nor" if lines else f"Describe a {keyword} for `make_scene`, with these attributes:")
        for attribute in row.attributes:
            limit = f", {attribute.limit.wanted}" if attribute.limit else ""
            lines.append(f"    {attribute.describe()}{limit}; default: {attribute.default_words}")
    construct.__name__ = construct.__qualname__ = keyword
    construct.__doc__ = "\n".join(lines).replace("; default: required", "; required")
    return construct


def __getattr__(keyword: str) -> Callable[..., Description]:
    if keyword not in BLOCK_TYPES:
        raise AttributeError(f"module {__name__!r} has no attribute {keyword!r}; there are {', '.join(__dir__())}")
    return _constructor(keyword)


def __dir__() -> list[str]:
    return ["make_scene", *BLOCK_TYPES]
