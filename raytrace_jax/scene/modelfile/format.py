"""Writing a scene as canonical text, which reads back to the same bits."""

import numpy as np

from raytrace_jax.errors import ModelFileError
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import BLOCK_KINDS, ModelName, is_name
from raytrace_jax.util.text import format_number, quoted

INDENT = "    "


def format_scene(scene: Scene, *, model: ModelName = "classic") -> str:
    """Write a scene as the text of a `model.txt`: camera, lights, materials, then shapes in `shape_order`.

    Attributes equal to their default under the model are left out. Numbers have the fewest digits for their array's
    dtype, so `parse_scene` with that dtype and model gives the same scene, bit for bit.

    Raises:
        ModelFileError: the scene holds NaN, infinity or a name that is not one word; no file can say that.
    """
    pixeldim = [f"pixeldim {scene.camera.pixeldim[0]} {scene.camera.pixeldim[1]}"]
    blocks = [_block("camera", scene.camera.name, pixeldim + _attributes(scene, "camera", None, model))]
    for keyword in ("light", "material"):
        for column, name in enumerate(getattr(scene, BLOCK_KINDS[keyword].group).names):
            blocks.append(_block(keyword, name, _attributes(scene, keyword, column, model)))
    blocks += _shapes(scene, model)
    return "\n".join(blocks)


def _shapes(scene: Scene, model: ModelName) -> list[str]:
    block_of_name = {}
    for keyword, shapes in (("plane", scene.planes), ("sphere", scene.spheres)):
        for column, name in enumerate(shapes.names):
            material = [f"material {scene.materials.names[shapes.material[column]]}"]
            block_of_name[name] = _block(keyword, name, material + _attributes(scene, keyword, column, model))
    return [block_of_name[name] for name in scene.shape_order]


def _block(keyword: str, name: str, lines: list[str]) -> str:
    if not is_name(name):
        raise ModelFileError(f"the {keyword} name {quoted(name)} cannot be written: a name is one word without braces.")
    return "".join([f"{keyword} {name} {{\n", *(f"{INDENT}{line}\n" for line in lines), "}\n"])


def _attributes(scene: Scene, keyword: str, column: int | None, model: ModelName) -> list[str]:
    """The lines for a block's numbers; `column` is None for the camera, which has no column axis."""
    kind = BLOCK_KINDS[keyword]
    lines = []
    for attribute in kind.continuous:
        values = np.asarray(getattr(getattr(scene, kind.group), attribute.name))
        values = values if column is None else values[..., column]
        if not np.all(np.isfinite(values)):
            raise ModelFileError(f"a {keyword} has {attribute.name} {values}, which no model.txt can say.")
        text = _number_text(values)
        if not _is_default(text, attribute.default_of(model), values.dtype):
            lines.append(f"{attribute.name} {text}")
    return lines


def _number_text(values: np.ndarray) -> str:
    return " ".join(format_number(value) for value in np.atleast_1d(values))


def _is_default(text: str, default: tuple[float, ...] | None, dtype: np.dtype) -> bool:
    # Compare texts: as numbers, -0 would equal a default of 0 and lose its sign.
    return default is not None and text == _number_text(np.array(default, dtype))
