"""The reader of `model.txt`: tokens, the grammar `keyword name { attribute values ... }`, and a file's way to a scene.

Tokens are words between white space, and braces. Where a word begins with `#` or `//`, a comment goes to the end of the
line.
"""

import dataclasses
import os
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jax.typing import DTypeLike

from raytrace_jax.errors import ModelFileError, ModelFileWarning
from raytrace_jax.scene.assemble import assemble, floating
from raytrace_jax.scene.bundled import no_such_scene, scene_path
from raytrace_jax.scene.rows import KEYWORD, NAME, Description, Origin
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute, is_name
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import ATTRIBUTE_NAMES, BLOCK_TYPES, SETTINGS
from raytrace_jax.util.numerics import cast
from raytrace_jax.util.text import did_you_mean, listed, looks_like_number, parse_integer, parse_number, quoted

OPENING, CLOSING = "{", "}"
"""Parts of a block in a file, besides those that any row has."""

_TOKEN = re.compile(r"(?P<comment>(?:#|//)[^\r\n]*+)|[{}]|[^\s{}]++")


class Token(NamedTuple):
    """A word or a brace; the end of the file is the token with an empty text."""

    text: str
    offset: int

    def __str__(self) -> str:
        return quoted(self.text) if self.text else "the end of the file"


class TokenStream:
    """Tokens one at a time with one token of look-ahead, `current`; the end token repeats for ever.

    `comments` are those on the way to the current token, each with the number of tokens before it.
    """

    def __init__(self, text: str, source: str):
        self._text = text
        self._source = source
        self._matches = _TOKEN.finditer(self._text)
        self._count = 0
        self.comments: list[tuple[Token, int]] = []
        self.current = self._next()

    def _next(self) -> Token:
        for match in self._matches:
            token = Token(match.group(), match.start())
            if not match["comment"]:
                self._count += 1
                return token
            self.comments.append((token, self._count))
        return Token("", len(self._text))

    def advance(self) -> Token:
        """Return the current token and step to the next."""
        token = self.current
        self.current = self._next()
        return token

    def line(self, token: Token) -> int:
        """The token's line, counted from 1."""
        return self._text.count("\n", 0, token.offset) + 1

    def position(self, token: Token) -> str:
        """The token's place as `file:line:column`, both counted from 1."""
        column = token.offset - self._text.rfind("\n", 0, token.offset)
        return f"{self._source}:{self.line(token)}:{column}"

    def error(self, token: Token, message: str) -> ModelFileError:
        """The error, for the caller to raise, that points at a token."""
        hint = " A comment begins after white space." if "#" in token.text or "//" in token.text else ""
        return ModelFileError(f"{self.position(token)}: {message}{hint}")


@dataclasses.dataclass
class FileOrigin(Origin):
    """A block's place in a file: the tokens of each of its parts in order, of an attribute its name and its values."""

    tokens: TokenStream = dataclasses.field(kw_only=True)
    tokens_of: dict[str, list[Token]] = dataclasses.field(kw_only=True)
    whole = "file"
    wants_relative_paths = True
    unclosed = " Or is the '}}' of {} missing?"

    def is_there(self, part: str) -> str:
        """The line of a part, as the end of a sentence."""
        return f"is in line {self.tokens.line(self.tokens_of[part][0])}"

    def shown(self, part: str, value: Any) -> str:
        """A value as it is written."""
        return quoted(" ".join(word.text for word in self.tokens_of[part][1:]))

    def error(self, part: str, message: str) -> ModelFileError:
        """The error that points at a part of the block, of an attribute at its first value if that was read."""
        return self.tokens.error(self.tokens_of[part][:2][-1], message)


def read_blocks(tokens: TokenStream, dtype: np.dtype, folder: Path) -> Iterator[Description]:
    """A file's blocks in order. Raises ModelFileError for what is no block, or has no such attribute."""
    first: Description | None = None
    while tokens.current.text:
        block = _read_block(tokens, dtype, folder)
        first = first or block
        # Defaults are those of the settings' model. Second settings are refused with other blocks that come once.
        if block.keyword == SETTINGS and first.keyword != SETTINGS:
            raise block.origin.error(KEYWORD, f"{block} comes too late: settings are the first block of a file.")
        yield block


def _read_block(tokens: TokenStream, dtype: np.dtype, folder: Path) -> Description:
    keyword = tokens.advance()
    if keyword.text == "}":
        raise tokens.error(keyword, "this '}' closes no block.")
    if keyword.text not in BLOCK_TYPES:
        guess = did_you_mean(keyword.text, BLOCK_TYPES)
        raise tokens.error(keyword, f"unknown keyword {keyword}.{guess} Valid keywords: {listed(BLOCK_TYPES)}.")
    name = tokens.advance()
    if not is_name(name.text):
        raise tokens.error(name, f"expected a name for this {keyword.text}, found {name}.")
    opening = tokens.advance()
    if opening.text != "{":
        raise tokens.error(opening, f"expected '{{' after {keyword.text} {name}, found {opening}.")
    tokens_of = {KEYWORD: [keyword], NAME: [name], OPENING: [opening]}
    block = Description(keyword.text, name.text, FileOrigin(folder, tokens=tokens, tokens_of=tokens_of))
    while tokens.current.text != "}":
        if not tokens.current.text:
            raise tokens.error(keyword, f"{block} is never closed: the file ends before its '}}'.")
        word = tokens.advance()
        attribute = word.text
        if attribute == "worldim" and keyword.text == "camera":  # The course's own writer spells it so.
            message = f"{tokens.position(word)}: 'worldim' is read as 'worlddim', as the file format spells it."
            warnings.warn(message, ModelFileWarning, stacklevel=2)
            attribute = "worlddim"
        if attribute in block.values:
            raise tokens.error(word, f"{block} has {attribute} twice.")
        tokens_of[attribute] = [word]
        admitted = block.admit(attribute)
        tokens_of[attribute] += _read_values(tokens, block, admitted, dtype)
    tokens_of[CLOSING] = [tokens.advance()]
    return block


def _read_values(tokens: TokenStream, block: Description, attributes: list[Attribute], dtype: np.dtype) -> list[Token]:
    """Read a word, or as many numbers as one of the attributes takes, into the block; return their tokens."""
    by_count = {attribute.value_count: attribute for attribute in reversed(attributes)}
    counts, one = sorted(by_count), attributes[0]
    takes = " or ".join(by_count[count].describe() for count in counts)
    read: list[Token] = []
    values: list[Any] = []
    # Where there are enough already, only what was meant as a number is one more.
    while len(read) < counts[-1] and (len(read) not in counts or looks_like_number(tokens.current.text)):
        token = tokens.current
        if one.is_text:
            if not is_name(token.text):
                raise tokens.error(token, f"in {block}, {takes}, found {token}.")
            values.append(token.text)
        else:
            if token.text in ("", "{", "}") or token.text in ATTRIBUTE_NAMES:
                raise tokens.error(token, f"too few values in {block}: {takes}, found {len(read)} before {token}.")
            try:
                is_whole = one.value_type == "integer"
                values.append(int(parse_integer(token.text)) if is_whole else parse_number(token.text))
            except ValueError as reason:
                raise tokens.error(token, f"in {block}, {takes}, but {reason}.") from None
            if one.value_type == "number" and not np.isfinite(cast(np.asarray(values[-1]), dtype)):
                raise tokens.error(token, f"in {block}, {one.name} {token} is too large, it is infinite in {dtype}.")
        read.append(tokens.advance())
    if looks_like_number(tokens.current.text):
        raise tokens.error(tokens.current, f"too many values: {takes}, then comes {tokens.current}.")
    block.values[one.name] = tuple(values) if by_count[len(values)].components else values[0]
    return read


def parse_scene(
    text: str,
    *,
    source: str = "<string>",
    dtype: DTypeLike | None = None,
    model: ModelName | None = None,
    folder: str | os.PathLike[str] = ".",
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
    text = text.removeprefix("\ufeff")  # the byte order mark that some editors write
    tokens = TokenStream(text, source)
    if "\0" in text:
        raise tokens.error(Token("\0", text.index("\0")), "a NUL byte: this is a binary file, not a model.txt.")
    if not tokens.current.text:
        raise tokens.error(tokens.current, "the file is empty: a scene has at least a camera block.")

    # A generator: the first error in the order of the file is raised, be it within a block or between two.
    blocks = read_blocks(tokens, float_dtype, Path(folder))
    return assemble(blocks, float_dtype, model, lambda message: tokens.error(tokens.current, message))


def load_scene(
    path: str | os.PathLike[str], *, dtype: DTypeLike | None = None, model: ModelName | None = None
) -> Scene:
    """The scene in a `model.txt` file (UTF-8, with or without a byte order mark).

    Args:
        path: the file, or where there is none the name of a scene that comes with the package, as `glass_on_board`.
        dtype, model: as for `parse_scene`.

    Raises:
        ModelFileError: the file cannot be read or is not a scene, as `parse_scene`.
    """
    path = scene_path(path)
    # So that a picture or an endless device given by mistake fails at once.
    most_bytes = 64 * 2**20
    try:
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
    except FileNotFoundError:
        raise ModelFileError(no_such_scene(path)) from None
    except IsADirectoryError:
        raise ModelFileError(f"{path}: this is a directory, a model.txt file is wanted.") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL character
        raise ModelFileError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}.") from None
    if len(content) > most_bytes:
        raise ModelFileError(f"{path}: larger than 64 MiB, this is not a model.txt.")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - content.rfind(b"\n", 0, error.start)
        raise ModelFileError(
            f"{path}:{line}:{column}: byte 0x{content[error.start]:02x} is not UTF-8: a model.txt is plain text."
        ) from None
    return parse_scene(text, source=str(path), dtype=dtype, model=model, folder=path.parent)
