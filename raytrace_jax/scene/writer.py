"""The writer of scenes: canonical text, which reads back to the same bits, files with their pictures, plain values."""

import dataclasses
import os
import warnings
from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from raytrace_jax.errors import ModelFileError, PictureError, SceneError
from raytrace_jax.images.exr import write_exr
from raytrace_jax.images.pictures import read_picture
from raytrace_jax.scene.parameters import Block, blocks, scene_model
from raytrace_jax.scene.reader import CLOSING, OPENING, FileOrigin, Token, TokenStream, read_blocks
from raytrace_jax.scene.rows import KEYWORD, NAME
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute, is_name
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.structs import Images
from raytrace_jax.util.digits import format_number
from raytrace_jax.util.files import write_text
from raytrace_jax.util.text import quoted

INDENT = "    "

Part = tuple[str, str, str]
"""A line of the canonical form: a block's keyword, its name, and an attribute, `OPENING` or `CLOSING`."""

TOP, END = ("", "", "top"), ("", "", "end")
"""The beginning and the end of a file."""


class Comments(NamedTuple):
    """The comments of a file, each with its `#` or `//`, so that the canonical form keeps them in place.

    Args:
        above: those on lines of their own, by the part that they come before.
        beside: those behind something, by the part that it is.
    """

    above: dict[Part, list[str]]
    beside: dict[Part, list[str]]

    def around(self, part: Part, line: str, above_indent: str = "") -> list[str]:
        """The line of a part, with its comments above and beside it."""
        above = [above_indent + comment for comment in self.above.get(part, [])]
        return [*above, "  ".join([line, *self.beside.get(part, [])])]


def read_comments(text: str) -> Comments:
    """The comments of a text that `parse_scene` reads.

    A comment on a line of its own belongs to what comes next, one behind something to that. Comments at the top of a
    file that an empty line follows belong to the file.
    """
    stream = TokenStream(text, "")
    tokens: list[Token] = []
    parts: list[Part] = []
    with warnings.catch_warnings(action="ignore"):
        for block in read_blocks(stream, np.dtype(float), Path()):
            assert isinstance(block.origin, FileOrigin)
            for part, its_tokens in block.origin.tokens_of.items():
                tokens += its_tokens
                parts += [(block.keyword, block.name, OPENING if part in (KEYWORD, NAME) else part)] * len(its_tokens)

    parts.append(END)
    comments = Comments(defaultdict(list), defaultdict(list))
    for comment, count in stream.comments:
        follows = count > 0 and stream.line(tokens[count - 1]) == stream.line(comment)
        # At the top, an empty line may lie between a comment and what follows it.
        end = tokens[0].offset if tokens else len(text)
        gap = text[comment.offset + len(comment.text) : end].split("\n")[1:-1] if count == 0 else []
        is_top = any(not line.strip() for line in gap)
        part = parts[count - 1] if follows else TOP if is_top else parts[count]
        (comments.beside if follows else comments.above)[part].append(comment.text.rstrip())
    return comments


def format_scene(scene: Scene, *, model: ModelName | None = None, comments: str = "") -> str:
    """The text of a scene in a `model.txt`: settings, camera, background, lights, textures, materials, shapes.

    Attributes equal to their default under the model are left out, but for the index of glass and what has a comment.
    Numbers have the fewest digits for their array's dtype, so `parse_scene` with that dtype and model gives the same
    scene, bit for bit.

    Args:
        model: whose defaults are left out; None is the model of the scene's settings, or `classic`.
        comments: the text of a file whose comments are kept, each at the block or the attribute that it belongs to.

    Raises:
        ModelFileError: the scene holds NaN, infinity or a name that is not one word; no file can say that.
    """
    known = model or scene_model(scene)
    kept = read_comments(comments)
    top, end = ("".join(f"{comment}\n" for comment in kept.above.get(part, [])) for part in (TOP, END))
    return "\n".join(filter(None, [top, *(_block_text(scene, block, known, kept) for block in blocks(scene)), end]))


def _block_text(scene: Scene, block: Block, model: ModelName, comments: Comments) -> str:
    if not is_name(block.name):
        raise ModelFileError(
            f"the {block.keyword} name {quoted(block.name)} cannot be written: a name is one word without braces."
        )
    opening, closing = ((block.keyword, block.name, brace) for brace in (OPENING, CLOSING))
    lines = comments.around(opening, f"{block.keyword} {block.name} {{")
    weights = [block.read(scene, name) for name in ("alpha", "transmission") if block.type.find(name)]
    is_glass = any(bool(weight != 0) for weight in weights)
    for attribute in block.type.attributes:
        part = (block.keyword, block.name, attribute.name)
        is_kept = part in comments.above or part in comments.beside or (is_glass and attribute.name == "ior")
        text = _value_text(scene, block, attribute, model, is_kept)
        if text:
            lines += comments.around(part, f"{INDENT}{attribute.name} {text}", INDENT)
    lines += comments.around(closing, "}", INDENT)
    return "".join(f"{line}\n" for line in lines)


def _value_text(scene: Scene, block: Block, attribute: Attribute, model: ModelName, is_kept: bool) -> str:
    """The value of an attribute; nothing where it has none, or its default and is not kept all the same."""
    value = plain_value(scene, block, attribute)
    if value is None or (attribute.value_type == "word" and value == attribute.default and not is_kept):
        return ""
    if attribute.is_text:
        if not is_name(value):
            what = f"{attribute.name} {quoted(value)}" if value else f"no {attribute.name}: its picture came as numbers"
            raise ModelFileError(f"the {block.keyword} {quoted(block.name)} has {what}, which no model.txt can say.")
        return value
    values = np.asarray(value)
    if not np.all(np.isfinite(values)):
        raise ModelFileError(f"a {block.keyword} has {attribute.name} {values}, which no model.txt can say.")
    text = _number_text(values)
    if attribute.value_type == "number" and not is_kept:
        # Texts are compared: as numbers, -0 would equal a default of 0 and lose its sign.
        default = attribute.default_of(model, lambda name: block.read(scene, name))
        return "" if default is not None and text == _number_text(np.array(default, values.dtype)) else text
    return text


def plain_value(scene: Scene, block: Block, attribute: Attribute) -> Any:
    """The value of an attribute: numbers as the scene has them, a word, the name of another block; None for none."""
    if not attribute.is_stored:
        return attribute.choices[0]
    if attribute.value_type == "name":
        named = block.refers_to(scene, attribute.name)
        return named.name if named else None
    return block.read(scene, attribute.name)


def _number_text(values: np.ndarray) -> str:
    return " ".join(format_number(value) for value in np.atleast_1d(values))


def scene_to_dict(scene: Scene) -> dict[str, Any]:
    """A scene as strings, numbers and lists: `{"model": "physical", "blocks": [{"block": "sphere", ...}, ...]}`.

    Blocks are in the order in which a file has them; each has its keyword as `block`, its `name`, and every attribute
    that has a value. Numbers come back exactly in the same dtype.

    Raises:
        SceneError: the scene has a picture that came as numbers, and no file.
    """
    rows = []
    for block in blocks(scene):
        values = {attribute.name: plain_value(scene, block, attribute) for attribute in block.type.attributes}
        if values.get("file") == "":
            raise SceneError(f"the {block.keyword} {quoted(block.name)} came as numbers: a file is wanted for it.")
        plain = {
            name: value if isinstance(value, str) else np.asarray(value).tolist()
            for name, value in values.items()
            if value is not None
        }
        rows.append({"block": block.keyword, "name": block.name, **plain})
    return {"model": scene.model, "blocks": rows}


def save_scene(
    scene: Scene, path: str | os.PathLike[str], *, model: ModelName | None = None, comments: str = ""
) -> str:
    """Write a scene's file, each file whole or not at all, and return its text.

    A texture whose file does not lie where the new scene's file would look for it is written beside that file, as
    `SCENE.TEXTURE.exr` in 32-bit floats; so is one that came as numbers.

    Args:
        path: the scene's file; missing folders are made.
        model, comments: see `format_scene`.

    Raises:
        ModelFileError: the scene holds what no file can say.
        RaytraceError: a file cannot be written.
    """
    path, images = Path(path), scene.images
    files = {
        k: f"{path.stem}.{name}.exr" for k, name in enumerate(images.names) if not _is_found(images, k, path.parent)
    }
    file = tuple(files.get(k, old) for k, old in enumerate(images.file))
    transfer = tuple(None if k in files else old for k, old in enumerate(images.transfer))
    moved = dataclasses.replace(scene, images=dataclasses.replace(images, file=file, transfer=transfer))
    text = format_scene(moved, model=model, comments=comments)
    for k, name in files.items():
        write_exr(path.parent / name, np.asarray(images.texels[k]))
    write_text(path, text)
    return text


def _is_found(images: Images, k: int, folder: Path) -> bool:
    """Whether the file of a texture, as the scene has it, is in a folder, with the same picture."""
    if not images.file[k] or not (folder / images.file[k]).is_file():
        return False
    try:
        stored = read_picture(folder / images.file[k], transfer=images.transfer[k])
    except PictureError:
        return False
    return np.array_equal(stored.astype(images.texels[k].dtype), np.asarray(images.texels[k]))
