"""The reader of `model.txt`: tokens, the grammar `keyword name { attribute values ... }`, and a file's way to a scene.

Tokens are words between white space or in quotes, and braces. Where a word begins with `#` or `//`, a comment goes to
the end of the line.
"""

import dataclasses
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from jax.typing import DTypeLike

from ..errors import ModelFileError, RaytraceWarning
from ..util.files import StrPath
from ..util.text import did_you_mean, listed, looks_like_number, parse_integer, parse_number, quoted
from .bundled import no_such_scene, scene_path
from .rows import HEAD, Description, assemble, either, floating
from .scene import Scene
from .schema import Attribute, is_name
from .setting_words import ModelName
from .table import BLOCK_TYPES

CLOSING = "}"
"""A part of a block in a file, besides those that any row has."""

_TOKEN = re.compile(r'(?P<comment>(?:#|//)[^\r\n]*+)|[{}]|"[^"{}\r\n]*+"(?=[\s{}]|\Z)|[^\s{}]++|\Z')


class Token(NamedTuple):
    """A word or a brace; the end of the file is the token with an empty text.

    Args:
        place: where it is, as `file:line:column`, both counted from 1.
        above, beside: the comments before it, on lines of their own, and those behind it.
    """

    text: str
    place: str
    above: list[str]
    beside: list[str]

    def __str__(self) -> str:
        return quoted(self.text) if self.text else "the end of the file"

    def error(self, message: str) -> ModelFileError:
        """The error, for the caller to raise, that points at the token."""
        hint = " A comment begins after white space." if "#" in self.text or "//" in self.text else ""
        return ModelFileError(f"{self.place}: {message}{hint}")


def _tokens(text: str, source: str) -> Iterator[Token]:
    line, line_start, counted = 1, 0, 0
    above: list[str] = []
    comments = above
    for match in _TOKEN.finditer(text):
        offset = match.start()
        if line_breaks := text.count("\n", counted, offset):
            line += line_breaks
            line_start = text.rfind("\n", counted, offset) + 1
            comments = above
        counted = offset
        if match["comment"]:
            comments.append(match.group().rstrip())
            continue
        token = Token(match.group(), f"{source}:{line}:{offset - line_start + 1}", above, [])
        yield token
        above, comments = [], token.beside


class TokenStream:
    """Tokens one at a time with one token of look-ahead, `current`; the end token repeats for ever."""

    def __init__(self, text: str, source: str):
        self._tokens = _tokens(text, source)
        self.current = next(self._tokens)

    def advance(self) -> Token:
        token = self.current
        self.current = next(self._tokens, token)
        return token


@dataclasses.dataclass
class FileBlock(Description):
    """A block of a file, with the tokens of each of its parts in order: of an attribute its name and its values."""

    tokens: dict[str, list[Token]] = dataclasses.field(default_factory=dict)

    def error(self, part: str, message: str) -> ModelFileError:
        """The error that points at the block's name, or at an attribute's first value if that was read."""
        return self.tokens[part][:2][-1].error(message)


def read_blocks(stream: TokenStream, folder: Path) -> Iterator[FileBlock]:
    """A file's blocks in order. Raises ModelFileError for what is no block, or has no such attribute."""
    while stream.current.text:
        keyword = stream.advance()
        if keyword.text not in BLOCK_TYPES:
            guess = did_you_mean(keyword.text, BLOCK_TYPES)
            raise keyword.error(f"unknown keyword {keyword}.{guess} Valid keywords: {listed(BLOCK_TYPES)}.")
        name = stream.advance()
        if not is_name(name.text):
            raise name.error(f"expected a name for this {keyword.text}, found {name}.")
        opening = stream.advance()
        if opening.text != "{":
            raise opening.error(f"expected '{{' after {keyword.text} {name}, found {opening}.")
        block = FileBlock(keyword.text, name.text, folder, tokens={HEAD: [keyword, name, opening]})
        while stream.current.text != "}":
            if not stream.current.text:
                raise keyword.error(f"{block} is never closed: the file ends before its '}}'.")
            _read_attribute(stream, block)
        block.tokens[CLOSING] = [stream.advance()]
        yield block


def _read_attribute(stream: TokenStream, block: FileBlock) -> None:
    """Read an attribute's name, and a word or as many numbers as it takes, into the block."""
    token = stream.advance()
    name = token.text
    if name == "worldim" and block.keyword == "camera":  # The course's own writer spells it so.
        message = f"{token.place}: 'worldim' is read as 'worlddim', as the file format spells it."
        warnings.warn(message, RaytraceWarning, stacklevel=2)
        name = "worlddim"
    if name in block.values:
        raise token.error(f"{block} has {name} twice.")
    if name in (*BLOCK_TYPES, "{") and not any(row.find(name) for row in BLOCK_TYPES[block.keyword]):
        raise token.error(f"{block} has no attribute {token}: is its '}}' missing?")
    read = block.tokens[name] = [token]
    attributes = block.admit(name)
    counts, takes = {attribute.value_count for attribute in attributes}, either(attributes)
    values: list[Any] = []
    # Where there are enough already, only what was meant as a number is one more.
    while len(values) < max(counts) and (len(values) not in counts or looks_like_number(stream.current.text)):
        try:
            values.append(_read_value(stream.current.text, attributes[0]))
        except ValueError as reason:
            after = f"after {len(values)} of them " if values else ""
            raise stream.current.error(f"in {block}, {takes}, but {after}{reason}.") from None
        read.append(stream.advance())
    if looks_like_number(stream.current.text):
        raise stream.current.error(f"too many values in {block}: {takes}, then comes {stream.current}.")
    block.values[name] = tuple(values) if len(values) > 1 else values[0]


def _read_value(text: str, attribute: Attribute) -> str | int | float:
    """A value of an attribute. Raises ValueError that says what is wrong with the text."""
    if attribute.value_type == "glass" and text not in ("", "}"):
        return text.strip('"')
    if attribute.is_text:
        if not is_name(text):
            raise ValueError(f"{quoted(text)} is none")
        if attribute.value_type == "file" and Path(text).is_absolute():
            raise ValueError(f"{quoted(text)} is an absolute path: a texture's is relative to the scene file")
        return text
    return int(parse_integer(text)) if attribute.value_type == "integer" else parse_number(text)


def parse_scene(
    text: str,
    *,
    source: str = "<string>",
    dtype: DTypeLike | None = None,
    model: ModelName | None = None,
    folder: StrPath = ".",
) -> Scene:
    """The scene of the text of a `model.txt`.

    Args:
        source: the file's name for error messages.
        dtype: floating dtype of the scene's arrays; None means JAX's default.
        model: the shading model with which the scene is rendered; its defaults fill in what the file leaves out. None
            is the model of the file's settings, else `classic`.
        folder: where the paths of its textures begin.

    Raises:
        ModelFileError: the text is not a scene; the message says where, what came and what is valid.
        TypeError: `dtype` is not a floating type.
    """
    float_dtype = floating(dtype)
    if not isinstance(text, str):
        raise ModelFileError(f"{source}: the text of a scene is wanted, and this is of the type {type(text).__name__}.")
    stream = TokenStream(text.removeprefix("\ufeff"), source)  # the byte order mark that some editors write
    # A generator: the first error in the order of the file is raised, be it within a block or between two.
    blocks = read_blocks(stream, Path(folder))
    return assemble(blocks, float_dtype, model, lambda message: stream.current.error(message))


def load_scene(path: StrPath, *, dtype: DTypeLike | None = None, model: ModelName | None = None) -> Scene:
    """The scene in a `model.txt` file (UTF-8, with or without a byte order mark).

    Args:
        path: the file, or where there is none the name of a scene that comes with the package, as `glass_on_board`.
        dtype, model: as for `parse_scene`.

    Raises:
        ModelFileError: the file cannot be read or is not a scene, as `parse_scene`.
    """
    path = scene_path(path)
    most_bytes = 64 * 2**20  # So that an endless device given by mistake fails at once.
    try:
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
        if len(content) > most_bytes:
            raise ModelFileError(f"{path}: larger than 64 MiB, this is not a model.txt.")
        text = content.decode("utf-8")
    except FileNotFoundError:
        raise ModelFileError(no_such_scene(path)) from None
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL character, or bytes that are no UTF-8.
        raise ModelFileError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}.") from None
    return parse_scene(text, source=str(path), dtype=dtype, model=model, folder=path.parent)
