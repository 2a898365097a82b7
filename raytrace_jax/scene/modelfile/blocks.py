"""The grammar: `keyword name { attribute values ... }`, each block checked on its own."""

import dataclasses
import warnings
from collections.abc import Iterator

import numpy as np

from raytrace_jax.errors import ModelFileError, ModelFileWarning
from raytrace_jax.scene.block_kinds import ATTRIBUTE_NAMES, BLOCK_KINDS
from raytrace_jax.scene.description import KEYWORD, NAME, Description
from raytrace_jax.scene.model_names import ModelName
from raytrace_jax.scene.modelfile.tokens import Token, TokenStream
from raytrace_jax.scene.schema import Attribute, is_name
from raytrace_jax.util.text import cast, did_you_mean, listed, looks_like_number, parse_integer, parse_number, quoted


@dataclasses.dataclass
class FileOrigin:
    """A block's place in a file: the token of each of its parts; of an attribute it is the first value."""

    tokens: TokenStream
    place_of: dict[str, Token]
    whole: str = "file"

    def is_there(self, part: str) -> str:
        """In which line a part of the block is."""
        return f"is in line {self.tokens.line(self.place_of[part])}"

    def unclosed(self, block: str) -> str:
        """A brace may be missing."""
        return f" Or is the '}}' of {block} missing?"

    def error(self, part: str, message: str) -> ModelFileError:
        """The error that points at a part of the block."""
        return self.tokens.error(self.place_of[part], message)


def read_blocks(tokens: TokenStream, dtype: np.dtype, model: ModelName) -> Iterator[Description]:
    """Yield the file's blocks in order: numbers of the given dtype, the model's defaults. Raises ModelFileError."""
    while tokens.current.text:
        yield _read_block(tokens, dtype, model)


def _read_block(tokens: TokenStream, dtype: np.dtype, model: ModelName) -> Description:
    block, place_of = _read_header(tokens)
    while tokens.current.text != "}":
        if not tokens.current.text:
            raise tokens.error(place_of[KEYWORD], f"{block} is never closed: the file ends before its '}}'.")
        _read_attribute(tokens, block, place_of, dtype)
    tokens.advance()
    block.complete(dtype, model)
    return block


def _read_header(tokens: TokenStream) -> tuple[Description, dict[str, Token]]:
    """A block without values, and the places of its parts, to which those of its attributes have to be added."""
    keyword = tokens.advance()
    if keyword.text == "}":
        raise tokens.error(keyword, "this '}' closes no block.")
    if keyword.text not in BLOCK_KINDS:
        raise tokens.error(
            keyword,
            f"unknown keyword {keyword}.{did_you_mean(keyword.text, BLOCK_KINDS)}"
            f" Valid keywords: {listed(BLOCK_KINDS)}.",
        )
    name = tokens.advance()
    if not is_name(name.text):
        raise tokens.error(name, f"expected a name for this {keyword.text}, found {name}.")
    opening = tokens.advance()
    if opening.text != "{":
        raise tokens.error(opening, f"expected '{{' after {keyword.text} {name}, found {opening}.")
    place_of = {KEYWORD: keyword, NAME: name}
    return Description(keyword.text, name.text, FileOrigin(tokens, place_of)), place_of


def _read_attribute(tokens: TokenStream, block: Description, place_of: dict[str, Token], dtype: np.dtype) -> None:
    word = tokens.advance()
    name = _spelled(tokens, block, word)
    if name in block.values:
        raise tokens.error(word, f"{block} has {name} twice.")
    place_of[name] = word
    attribute = block.admit(name)
    place_of[name] = tokens.current
    if attribute.kind == "name":
        block.values[name] = _read_name(tokens, block, attribute)
    else:
        block.values[name] = _read_numbers(tokens, block, attribute, dtype)
    if looks_like_number(tokens.current.text):
        raise tokens.error(tokens.current, f"too many values: {attribute.describe()}, then comes {tokens.current}.")


def _spelled(tokens: TokenStream, block: Description, word: Token) -> str:
    """An attribute's name as the format spells it; the course's writer has a spelling of its own."""
    if word.text == "worldim" and block.keyword == "camera":
        message = f"{tokens.position(word)}: 'worldim' is read as 'worlddim', as the file format spells it."
        warnings.warn(message, ModelFileWarning, stacklevel=2)
        return "worlddim"
    return word.text


def _read_name(tokens: TokenStream, block: Description, attribute: Attribute) -> str:
    if not is_name(tokens.current.text):
        raise tokens.error(tokens.current, f"in {block}, {attribute.describe()}, found {tokens.current}.")
    return tokens.advance().text


def _read_numbers(tokens: TokenStream, block: Description, attribute: Attribute, dtype: np.dtype) -> np.ndarray:
    parse = parse_integer if attribute.kind == "integer" else parse_number
    words: list[Token] = []
    exact = np.empty(attribute.value_count)
    for i in range(attribute.value_count):
        word = tokens.current
        if word.text in ("", "{", "}") or word.text in ATTRIBUTE_NAMES:
            message = f"too few values in {block}: {attribute.describe()}, found {i} before {word}."
            raise tokens.error(word, message)
        try:
            exact[i] = parse(word.text)
        except ValueError as reason:
            raise tokens.error(word, f"in {block}, {attribute.describe()}, but {reason}.") from None
        words.append(tokens.advance())

    values = exact if attribute.kind == "integer" else cast(exact, dtype)
    for word, value in zip(words, values, strict=True):
        if not np.isfinite(value):
            raise tokens.error(word, f"in {block}, {attribute.name} {word} is too large, it is infinite in {dtype}.")
    violation = attribute.violation(values)
    if violation:
        rounded = "" if attribute.violation(exact) else f", which {dtype} rounds to {' '.join(map(str, values))}"
        found = quoted(" ".join(word.text for word in words))
        raise tokens.error(words[0], f"in {block}, {violation}, found {found}{rounded}.")
    return values.reshape(attribute.shape)
