"""The tokens of a `model.txt`: words between white space, and braces; each knows its place in the file.

Where a word begins with `#` or `//`, a comment goes to the end of the line.
"""

import re
from typing import NamedTuple

from raytrace_jax.errors import ModelFileError
from raytrace_jax.util.text import quoted

_TOKEN = re.compile(r"(?P<comment>(?:#|//)[^\r\n]*+)|[{}]|[^\s{}]++")


class Token(NamedTuple):
    """A word or a brace; the end of the file is the token with an empty text."""

    text: str
    offset: int

    def __str__(self) -> str:
        return quoted(self.text) if self.text else "the end of the file"


class TokenStream:
    """Tokens one at a time with one token of look-ahead, `current`; the end token repeats for ever.

    Args:
        text: the file's text.
        source: the file's name, for error messages.

    Attributes:
        comments: those that were passed on the way to the current token.
    """

    def __init__(self, text: str, source: str):
        self._text = text
        self._source = source
        self._matches = _TOKEN.finditer(self._text)
        self.comments: list[Token] = []
        self.current = self._next()

    def _next(self) -> Token:
        for match in self._matches:
            token = Token(match.group(), match.start())
            if not match["comment"]:
                return token
            self.comments.append(token)
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
        """Return (for the caller to raise) the error that points at a token."""
        hint = " A comment begins after white space." if "#" in token.text or "//" in token.text else ""
        return ModelFileError(f"{self.position(token)}: {message}{hint}")
