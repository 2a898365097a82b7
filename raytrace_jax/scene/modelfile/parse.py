"""From blocks to a `Scene`: what holds between blocks (names, materials, one camera)."""

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array

from raytrace_jax.scene.modelfile.blocks import Block, read_blocks
from raytrace_jax.scene.modelfile.tokens import Token, TokenStream
from raytrace_jax.scene.scene import Camera, Materials, Planes, PointLights, Scene, Spheres
from raytrace_jax.scene.schema import BLOCK_KINDS, SHAPE_KEYWORDS, ModelName
from raytrace_jax.util.text import did_you_mean, listed


def parse_scene(
    text: str, *, source: str = "<string>", dtype: DTypeLike | None = None, model: ModelName = "classic"
) -> Scene:
    """Read a scene from the text of a `model.txt`.

    Args:
        text: the file's text; white space and line breaks only separate tokens.
        source: the file's name for error messages.
        dtype: floating dtype of the scene's arrays; None means JAX's default.
        model: whose defaults hold for attributes that the file leaves out.

    Returns:
        The scene; lights, materials and shapes keep the order of the file.

    Raises:
        ModelFileError: the text is not a scene; the message says where, what came and what is valid.
        TypeError: `dtype` is not a floating type.
    """
    # JAX decides what a dtype becomes (and warns if float64 was asked for while x64 is off).
    float_dtype = jnp.zeros((), dtype).dtype
    if not jnp.issubdtype(float_dtype, jnp.floating):
        raise TypeError(f"dtype must be a floating type, got {float_dtype}")

    text = text.removeprefix("\ufeff")  # the byte order mark that some editors write
    tokens = TokenStream(text, source)
    if "\0" in text:
        raise tokens.error(Token("\0", text.index("\0")), "a NUL byte: this is a binary file, not a model.txt.")
    if not tokens.current.text:
        raise tokens.error(tokens.current, "the file is empty: a scene has at least a camera block.")

    blocks = _collect(tokens, float_dtype, model)
    material_names = _names(blocks["material"])
    material_column = {name: column for column, name in enumerate(material_names)}

    def material_columns(shapes: list[Block]) -> tuple[int, ...]:
        return tuple(_material_column(tokens, shape, material_column) for shape in shapes)

    camera = blocks["camera"][0]
    shapes = sorted(blocks["plane"] + blocks["sphere"], key=lambda block: block.keyword.offset)
    width, height = (int(side) for side in camera.numbers["pixeldim"])
    return Scene(
        camera=Camera(
            name=camera.name.text,
            pixeldim=(width, height),
            worlddim=jnp.asarray(camera.numbers["worlddim"]),
            viewpoint=jnp.asarray(camera.numbers["viewpoint"]),
        ),
        lights=PointLights(names=_names(blocks["light"]), **_columns("light", blocks, float_dtype)),
        materials=Materials(names=material_names, **_columns("material", blocks, float_dtype)),
        planes=Planes(
            names=_names(blocks["plane"]),
            material=material_columns(blocks["plane"]),
            **_columns("plane", blocks, float_dtype),
        ),
        spheres=Spheres(
            names=_names(blocks["sphere"]),
            material=material_columns(blocks["sphere"]),
            **_columns("sphere", blocks, float_dtype),
        ),
        shape_order=_names(shapes),
    )


def _collect(tokens: TokenStream, dtype: np.dtype, model: ModelName) -> dict[str, list[Block]]:
    """Sort the blocks by keyword, and refuse doubled names, a second camera and a missing camera."""
    blocks: dict[str, list[Block]] = {keyword: [] for keyword in BLOCK_KINDS}
    first_of_name: dict[tuple[str, str], Block] = {}
    for block in read_blocks(tokens, dtype, model):
        keyword = block.keyword.text
        if keyword == "camera" and blocks["camera"]:
            first = blocks["camera"][0]
            raise tokens.error(
                block.keyword, f"a second camera; {first} is in line {tokens.line(first.keyword)}, a scene has one."
            )
        namespace = "shape" if keyword in SHAPE_KEYWORDS else keyword
        first = first_of_name.setdefault((namespace, block.name.text), block)
        if first is not block:
            raise tokens.error(
                block.name, f"the {namespace} name {block.name} is taken: {first} is in line {tokens.line(first.name)}."
            )
        blocks[keyword].append(block)
    if not blocks["camera"]:
        raise tokens.error(tokens.current, "the scene has no camera: a camera block must be somewhere in the file.")
    return blocks


def _names(blocks: list[Block]) -> tuple[str, ...]:
    return tuple(block.name.text for block in blocks)


def _columns(keyword: str, blocks: dict[str, list[Block]], dtype: np.dtype) -> dict[str, Array]:
    """Stack each attribute of all blocks of a kind into an array with components first, one column a block."""
    stacked = {}
    for attribute in BLOCK_KINDS[keyword].continuous:
        rows = [block.numbers[attribute.name] for block in blocks[keyword]]
        stacked[attribute.name] = jnp.asarray(np.array(rows, dtype).reshape(len(rows), *attribute.shape).T)
    return stacked


def _material_column(tokens: TokenStream, shape: Block, material_column: dict[str, int]) -> int:
    assert shape.material is not None  # a required attribute of every shape
    column = material_column.get(shape.material.text)
    if column is None:
        raise tokens.error(
            shape.material,
            f"{shape} has the unknown material {shape.material}."
            f"{did_you_mean(shape.material.text, material_column)} Materials in this file: {listed(material_column)}.",
        )
    return column
