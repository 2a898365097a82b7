"""The grammar: `keyword name { attribute values ... }`, each block checked on its own."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from raytrace_jax.errors import ModelFileWarning
from raytrace_jax.scene.modelfile.tokens import Token, TokenStream
from raytrace_jax.scene.schema import ATTRIBUTE_NAMES, BLOCK_KINDS, Attribute, BlockKind, ModelName, is_name
from raytrace_jax.util.text import cast, did_you_mean, listed, looks_like_number, parse_integer, parse_number, quoted


@dataclass
class Block:
    """A block as the file has it: numbers by attribute (defaults filled in) and, for a shape, its material."""

    keyword: Token
    name: Token
    numbers: dict[str, np.ndarray] = field(default_factory=dict)
    material: Token | None = None

    def __str__(self) -> str:
        return f"{self.keyword.text} {self.name}"

    @property
    def kind(self) -> BlockKind:
        """The row of the schema that this block follows."""
        return BLOCK_KINDS[self.keyword.text]

    def has(self, attribute: Attribute) -> bool:
        """Whether the block has given this attribute so far."""
        return self.material is not None if attribute.kind == "name" else attribute.name in self.numbers


def read_blocks(tokens: TokenStream, dtype: np.dtype, model: ModelName) -> Iterator[Block]:
    """Yield the file's blocks in order: numbers of the given dtype, the model's defaults. Raises ModelFileError."""
    while tokens.current.text:
        yield _read_block(tokens, dtype, model)


def _read_block(tokens: TokenStream, dtype: np.dtype, model: ModelName) -> Block:
    block = _read_header(tokens)
    while tokens.current.text != "}":
        if not tokens.current.text:
            raise tokens.error(block.keyword, f"{block} is never closed: the file ends before its '}}'.")
        _read_attribute(tokens, block, dtype)
    tokens.advance()
    _complete(tokens, block, dtype, model)
    return block


def _read_header(tokens: TokenStream) -> Block:
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
    return Block(keyword, name)


def _read_attribute(tokens: TokenStream, block: Block, dtype: np.dtype) -> None:
    word = tokens.advance()
    attribute = _find_attribute(tokens, block, word)
    if block.has(attribute):
        raise tokens.error(word, f"{block} has {attribute.name} twice.")
    if attribute.kind == "name":
        block.material = _read_material_name(tokens, block, attribute)
    else:
        block.numbers[attribute.name] = _read_numbers(tokens, block, attribute, dtype)
    if looks_like_number(tokens.current.text):
        raise tokens.error(tokens.current, f"too many values: {attribute.describe()}, then comes {tokens.current}.")


def _find_attribute(tokens: TokenStream, block: Block, word: Token) -> Attribute:
    name = word.text
    if name == "worldim" and block.keyword.text == "camera":
        message = f"{tokens.position(word)}: 'worldim' is read as 'worlddim', as the file format spells it."
        warnings.warn(message, ModelFileWarning, stacklevel=2)
        name = "worlddim"
    attribute = block.kind.find(name)
    if attribute is None:
        valid = [attribute.name for attribute in block.kind.attributes]
        missing_brace = f" Or is the '}}' of {block} missing?" if name in BLOCK_KINDS or name == "{" else ""
        raise tokens.error(
            word,
            f"unknown attribute {word} in {block}.{did_you_mean(name, valid)}"
            f" Valid attributes of a {block.keyword.text}: {listed(valid)}.{missing_brace}",
        )
    return attribute


def _read_material_name(tokens: TokenStream, block: Block, attribute: Attribute) -> Token:
    if not is_name(tokens.current.text):
        raise tokens.error(tokens.current, f"in {block}, {attribute.describe()}, found {tokens.current}.")
    return tokens.advance()


def _read_numbers(tokens: TokenStream, block: Block, attribute: Attribute, dtype: np.dtype) -> np.ndarray:
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


def _complete(tokens: TokenStream, block: Block, dtype: np.dtype, model: ModelName) -> None:
    """Fill in the defaults and refuse a block that lacks what has none."""
    missing = []
    for attribute in block.kind.attributes:
        if block.has(attribute):
            continue
        default = attribute.default_of(model)
        if default is None:
            missing.append(attribute.name)
        else:
            block.numbers[attribute.name] = np.array(default, dtype).reshape(attribute.shape)
    if missing:
        needed = listed(attribute.name for attribute in block.kind.attributes if attribute.default is None)
        raise tokens.error(
            block.keyword, f"{block} lacks {listed(missing)}. A {block.keyword.text} must have: {needed}."
        )
