"""The grammar: `keyword name { attribute values ... }`, each block checked on its own."""

import dataclasses
import warnings
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from raytrace_jax.errors import ModelFileError, ModelFileWarning
from raytrace_jax.scene.block_kinds import ATTRIBUTE_NAMES, BLOCK_KINDS, SETTINGS
from raytrace_jax.scene.description import KEYWORD, NAME, Description
from raytrace_jax.scene.modelfile.tokens import Token, TokenStream
from raytrace_jax.scene.schema import Attribute, is_name
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.util.numerics import cast
from raytrace_jax.util.text import did_you_mean, listed, looks_like_number, parse_integer, parse_number, quoted


@dataclasses.dataclass
class FileOrigin:
    """A block's place in a file: the token of each of its parts; of an attribute it is the first value."""

    tokens: TokenStream
    place_of: dict[str, Token]
    folder: Path
    whole: str = "file"
    wants_relative_paths: bool = True

    def is_there(self, part: str) -> str:
        """In which line a part of the block is."""
        return f"is in line {self.tokens.line(self.place_of[part])}"

    def unclosed(self, block: str) -> str:
        """A brace may be missing."""
        return f" Or is the '}}' of {block} missing?"

    def error(self, part: str, message: str) -> ModelFileError:
        """The error that points at a part of the block."""
        return self.tokens.error(self.place_of[part], message)


def read_blocks(tokens: TokenStream, dtype: np.dtype, model: ModelName | None, folder: Path) -> Iterator[Description]:
    """Yield the file's blocks in order: numbers of the given dtype, the model's defaults. Raises ModelFileError.

    Args:
        tokens: the file's.
        dtype: of its numbers.
        model: whose defaults hold; None is that of the file's settings, or the classic one. So that nothing has to be
            read twice, settings come first.
        folder: where the paths in it begin.
    """
    first: Description | None = None
    while tokens.current.text:
        block = _read_block(tokens, dtype, model or "classic", folder)
        first = first or block
        if block.keyword == SETTINGS:
            # Second settings are refused with other blocks of which a scene has one.
            if first.keyword != SETTINGS:
                raise block.origin.error(KEYWORD, f"{block} comes too late: settings are the first block of a file.")
            model = model or block.values["model"]
        yield block


def _read_block(tokens: TokenStream, dtype: np.dtype, model: ModelName, folder: Path) -> Description:
    block, place_of = _read_header(tokens, folder)
    while tokens.current.text != "}":
        if not tokens.current.text:
            raise tokens.error(place_of[KEYWORD], f"{block} is never closed: the file ends before its '}}'.")
        _read_attribute(tokens, block, place_of, dtype)
    tokens.advance()
    block.complete(dtype, model)
    return block


def _read_header(tokens: TokenStream, folder: Path) -> tuple[Description, dict[str, Token]]:
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
    return Description(keyword.text, name.text, FileOrigin(tokens, place_of, folder)), place_of


def _read_attribute(tokens: TokenStream, block: Description, place_of: dict[str, Token], dtype: np.dtype) -> None:
    word = tokens.advance()
    name = _spelled(tokens, block, word)
    if name in block.values:
        raise tokens.error(word, f"{block} has {name} twice.")
    place_of[name] = word
    attributes = block.admit(name)
    place_of[name] = tokens.current
    if attributes[0].is_text:
        block.values[name] = _read_word(tokens, block, attributes)
        _refuse_more(tokens, attributes[0].describe())
    else:
        block.values[name] = _read_numbers(tokens, block, attributes, dtype)


def _spelled(tokens: TokenStream, block: Description, word: Token) -> str:
    """An attribute's name as the format spells it; the course's writer has a spelling of its own."""
    if word.text == "worldim" and block.keyword == "camera":
        message = f"{tokens.position(word)}: 'worldim' is read as 'worlddim', as the file format spells it."
        warnings.warn(message, ModelFileWarning, stacklevel=2)
        return "worlddim"
    return word.text


def _read_word(tokens: TokenStream, block: Description, attributes: list[Attribute]) -> str:
    word = tokens.current
    choices = tuple(dict.fromkeys(chain.from_iterable(attribute.choices for attribute in attributes)))
    wanted = f"{attributes[0].name} is {' or '.join(choices)}" if choices else attributes[0].describe()
    if not is_name(word.text):
        raise tokens.error(word, f"in {block}, {wanted}, found {word}.")
    if choices and word.text not in choices:
        raise tokens.error(word, f"in {block}, {wanted}, found {word}.{did_you_mean(word.text, choices)}")
    return tokens.advance().text


def _read_numbers(tokens: TokenStream, block: Description, attributes: list[Attribute], dtype: np.dtype) -> Any:
    """The values of an attribute: as many as there are, if one of the things that it can be takes so many."""
    counts = sorted({attribute.value_count for attribute in attributes})
    by_count = {attribute.value_count: attribute for attribute in reversed(attributes)}
    attribute = by_count[counts[0]]
    parse = parse_integer if attribute.kind == "integer" else parse_number
    words: list[Token] = []
    exact: list[float] = []
    while len(exact) < counts[-1]:
        word = tokens.current
        # Where there are enough already, only what was meant as a number is one more.
        if len(exact) in counts and not looks_like_number(word.text):
            break
        if word.text in ("", "{", "}") or word.text in ATTRIBUTE_NAMES:
            message = f"too few values in {block}: {_takes(by_count)}, found {len(exact)} before {word}."
            raise tokens.error(word, message)
        try:
            exact.append(parse(word.text))
        except ValueError as reason:
            raise tokens.error(word, f"in {block}, {_takes(by_count)}, but {reason}.") from None
        words.append(tokens.advance())
    _refuse_more(tokens, _takes(by_count))

    attribute = by_count[len(exact)]
    found = np.array(exact)
    values = cast(found, dtype) if attribute.kind == "number" else found
    for word, value in zip(words, values, strict=True):
        if not np.isfinite(value):
            raise tokens.error(word, f"in {block}, {attribute.name} {word} is too large, it is infinite in {dtype}.")
    violation = attribute.violation(values)
    if violation:
        rounded = "" if attribute.violation(found) else f", which {dtype} rounds to {' '.join(map(str, values))}"
        text = quoted(" ".join(word.text for word in words))
        raise tokens.error(words[0], f"in {block}, {violation}, found {text}{rounded}.")
    return values.reshape(attribute.shape)


def _refuse_more(tokens: TokenStream, takes: str) -> None:
    if looks_like_number(tokens.current.text):
        raise tokens.error(tokens.current, f"too many values: {takes}, then comes {tokens.current}.")


def _takes(by_count: dict[int, Attribute]) -> str:
    """What the attribute takes, in words."""
    return " or ".join(by_count[count].describe() for count in sorted(by_count))
