"""The writer of scenes: canonical text, which reads back to the same bits, files with their pictures, plain values."""

import dataclasses
import itertools
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ModelFileError, PictureError, SceneError
from ..images.exr import write_exr
from ..images.pictures import read_whole_picture
from ..util.digits import format_number
from ..util.files import StrPath, write_text
from ..util.text import quoted
from .parameters import Block, blocks, scene_model
from .reader import CLOSING, Token, TokenStream, read_blocks
from .rows import HEAD
from .scene import Scene
from .schema import Attribute, is_name
from .setting_words import ModelName
from .structs import Images

Parts = dict[tuple[str, str, str], list[Token]]
"""The tokens of a file, with their comments, by keyword and name of a block and its part: see `reader.FileBlock`."""


def read_comments(text: str) -> tuple[list[str], Parts, list[str]]:
    """The comments of a text that `parse_scene` reads: those of the file at its top, of parts of blocks, at its end.

    A comment on a line of its own belongs to what comes next, one behind something to that. Comments at the top of a
    file that an empty line follows belong to the file.
    """
    lines = (line.strip() for line in text.split("\n"))
    head = itertools.takewhile(lambda line: not line or line.startswith(("#", "//")), lines)
    top = list(filter(None, "\n".join([*head, ""]).rpartition("\n\n")[0].split("\n")))
    stream = TokenStream(text, "")
    del stream.current.above[: len(top)]
    parts: Parts = {}
    with warnings.catch_warnings(action="ignore"):
        for block in read_blocks(stream, Path()):
            parts |= {(block.keyword, block.name, part): tokens for part, tokens in block.tokens.items()}
    return top, parts, stream.current.above


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
    top, parts, end = read_comments(comments)
    texts = [top, *(_block_lines(scene, block, known, parts) for block in blocks(scene)), end]
    return "\n".join("".join(f"{line}\n" for line in lines) for lines in texts if lines)


def _block_lines(scene: Scene, block: Block, model: ModelName, parts: Parts) -> list[str]:
    if not is_name(block.name):
        name = f"the {block.keyword} name {quoted(block.name)}"
        raise ModelFileError(f"{name} cannot be written: a name is one word without braces.")
    weights = [block.read(scene, name) for name in ("alpha", "transmission") if block.type.find(name)]
    is_glass = any(float(weight) != 0 for weight in weights)
    lines: list[str] = []
    for part in (HEAD, *(attribute.name for attribute in block.type.attributes), CLOSING):
        tokens = parts.get((block.keyword, block.name, part), [])
        above = [comment for token in tokens for comment in token.above]
        beside = [comment for token in tokens for comment in token.beside]
        if attribute := block.type.find(part):
            is_kept = bool(above or beside) or (is_glass and part == "ior")
            value = _attribute_text(scene, block, attribute, model, is_kept)
            if not value:
                continue
            line = f"    {part} {value}"
        else:
            line = CLOSING if part == CLOSING else f"{block.keyword} {block.name} {{"
        lines += [comment if part == HEAD else f"    {comment}" for comment in above]
        lines.append("  ".join([line, *beside]))
    return lines


def _attribute_text(scene: Scene, block: Block, attribute: Attribute, model: ModelName, is_kept: bool) -> str:
    """The value of an attribute; nothing where it has none, or its default and is not kept all the same."""
    value = plain_value(scene, block, attribute)
    if value is None:
        return ""
    if not (is_name(value) if attribute.is_text else np.all(np.isfinite(value))):
        got = f"{attribute.name} {quoted(str(value))}"
        raise ModelFileError(f"the {block.keyword} {quoted(block.name)} has {got}, which no model.txt can say.")
    text = value_text(value)
    default = attribute.default_of(model, lambda name: block.read(scene, name))
    if default is not None and not attribute.is_text:
        default = np.array(default, np.asarray(value).dtype)
    # Texts are compared: as numbers, -0 would equal a default of 0 and lose its sign.
    return "" if default is not None and text == value_text(default) and not is_kept else text


def value_text(value: Any) -> str:
    """A word, or numbers with the fewest digits for their dtype, as a file has them."""
    return value if isinstance(value, str) else " ".join(map(format_number, np.atleast_1d(value)))


def plain_value(scene: Scene, block: Block, attribute: Attribute) -> Any:
    """The value of an attribute: numbers as the scene has them, a word, the name of another block; None for none."""
    if attribute.value_type != "name":
        return block.read(scene, attribute.name)
    named = block.refers_to(scene, attribute.name)
    return named.name if named else None


def scene_to_dict(scene: Scene) -> dict[str, Any]:
    """A scene as strings, numbers and lists: `{"model": "physical", "blocks": [{"block": "sphere", ...}, ...]}`.

    Blocks are in the order in which a file has them; each has its keyword as `block`, its `name`, and every attribute
    that has a value. Numbers come back exactly in the same dtype. Raises SceneError for a picture that has no file.
    """
    rows = []
    for block in blocks(scene):
        row: dict[str, Any] = {"block": block.keyword, "name": block.name}
        for attribute in block.type.attributes:
            value = plain_value(scene, block, attribute)
            if attribute.value_type == "file" and not value:
                raise SceneError(f"the {block.keyword} {quoted(block.name)} came as numbers: a file is wanted for it.")
            if value is not None:
                row[attribute.name] = value if isinstance(value, str) else np.asarray(value).tolist()
        rows.append(row)
    return {"model": scene.model, "blocks": rows}


def save_scene(scene: Scene, path: StrPath, *, model: ModelName | None = None, comments: str = "") -> str:
    """Write a scene's file, each file whole or not at all, and return its text.

    A texture whose file does not lie where the new scene's file would look for it is written beside that file, as
    `SCENE.TEXTURE.exr` in 32-bit floats; so is one that came as numbers. Missing folders are made. `model` and
    `comments` are those of `format_scene`.

    Raises:
        ModelFileError: the scene holds what no file can say.
        RaytraceError: a file cannot be written.
    """
    path, images = Path(path), scene.images
    stored = [_is_stored(images, k, path.parent) for k in range(len(images.names))]
    files = {k: f"{path.stem}.{images.names[k]}.exr" for k, is_stored in enumerate(stored) if not is_stored}
    file = tuple(files.get(k, old) for k, old in enumerate(images.file))
    transfer = tuple(None if k in files else old for k, old in enumerate(images.transfer))
    moved = dataclasses.replace(scene, images=dataclasses.replace(images, file=file, transfer=transfer))
    text = format_scene(moved, model=model, comments=comments)
    for k, name in files.items():
        write_exr(path.parent / name, np.asarray(images.texels[k]))
    write_text(path, text)
    return text


def _is_stored(images: Images, k: int, folder: Path) -> bool:
    """Whether the file of a texture, as the scene has it, is in a folder, with the same picture."""
    if not images.file[k] or not (folder / images.file[k]).is_file():
        return False
    try:
        stored = read_whole_picture(folder / images.file[k], transfer=images.transfer[k])
    except PictureError:
        return False
    return np.array_equal(stored.astype(images.texels[k].dtype), np.asarray(images.texels[k]))
