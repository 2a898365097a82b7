"""The comments of a scene's file, and where they belong, so that the canonical form keeps them in place."""

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.modelfile.tokens import Token, TokenStream
from raytrace_jax.util.text import looks_like_number

Part = tuple[str, str, str]
"""A line of the canonical form: a block's keyword, its name, and an attribute, `OPENING` or `CLOSING`."""

OPENING, CLOSING = "{", "}"

TOP, END = ("", "", "top"), ("", "", "end")
"""The beginning and the end of a file."""

RESPELLED = {"worldim": "worlddim"}
"""Attributes that are read as another one."""


class Comments(NamedTuple):
    """The comments of a file, each with its `#` or `//`.

    Args:
        above: those on lines of their own, by the part that they come before.
        beside: those behind something, by the part that it is.
    """

    above: dict[Part, list[str]]
    beside: dict[Part, list[str]]

    def has(self, part: Part) -> bool:
        """Whether a part has any."""
        return part in self.above or part in self.beside

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
    counts: list[int] = []  # How many tokens come before each comment.
    while True:
        counts += [len(tokens)] * (len(stream.comments) - len(counts))
        if not stream.current.text:
            break
        tokens.append(stream.advance())

    parts = [*_parts(tokens), END]
    comments = Comments(defaultdict(list), defaultdict(list))
    for count, comment in zip(counts, stream.comments, strict=True):
        follows = count > 0 and stream.line(tokens[count - 1]) == stream.line(comment)
        is_top = count == 0 and _is_apart(text, comment, tokens[0] if tokens else None)
        part = parts[count - 1] if follows else TOP if is_top else parts[count]
        (comments.beside if follows else comments.above)[part].append(comment.text.rstrip())
    return comments


def _is_apart(text: str, comment: Token, following: Token | None) -> bool:
    """Whether an empty line lies between a comment and what follows it."""
    end = len(text) if following is None else following.offset
    lines = text[comment.offset + len(comment.text) : end].split("\n")
    return any(not line.strip() for line in lines[1:-1])


def _parts(tokens: list[Token]) -> Iterator[Part]:
    """The part that each token of a scene's text belongs to."""
    keyword = name = attribute = ""
    values_left = 0.0
    for number, token in enumerate(tokens):
        if not keyword:
            keyword, name, attribute = token.text, tokens[number + 1].text, OPENING
            values_left = 2.0  # The name and the brace.
        elif values_left > 0 and (values_left < float("inf") or looks_like_number(token.text)):
            values_left -= 1
        elif token.text == CLOSING:
            attribute = CLOSING
        else:
            attribute = RESPELLED.get(token.text, token.text)
            found = (kind.find(attribute) for kind in BLOCK_KINDS[keyword])
            # A word, or as many numbers as there are.
            values_left = 1.0 if any(one.is_text for one in found if one) else float("inf")
        yield keyword, name, attribute
        if attribute == CLOSING:
            keyword = ""
