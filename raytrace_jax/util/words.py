"""Words for messages to people; free of NumPy, for the command line's help."""

import difflib
from collections.abc import Iterable, Sequence

LONGEST_QUOTE = 60
LONGEST_LIST = 30


def quoted(text: str) -> str:
    """Quote user input on one line, cut to a readable length."""
    shown = text if len(text) <= LONGEST_QUOTE else text[:LONGEST_QUOTE] + "…"
    return repr(shown)


def listed(names: Iterable[str]) -> str:
    """List names with commas, cut to a readable length; `none` if there are none."""
    names = list(names)
    shown = [name if len(name) <= LONGEST_QUOTE else name[:LONGEST_QUOTE] + "…" for name in names[:LONGEST_LIST]]
    rest = f" and {len(names) - LONGEST_LIST} more" if len(names) > LONGEST_LIST else ""
    return (", ".join(shown) or "none") + rest


def sentence(text: str) -> str:
    """The text with a full stop, unless it ends in a mark already."""
    return text if text.endswith((".", "?", "!")) else f"{text}."


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ` Did you mean 'x'?` for the known name closest to the word, or nothing if none is close."""
    # difflib takes quadratic time in a word's length: no name that a person mistyped is this long.
    if len(word) > LONGEST_QUOTE:
        return ""
    by_lower_case = {name.lower(): name for name in known if len(name) <= LONGEST_QUOTE}
    matches = difflib.get_close_matches(word.lower(), by_lower_case, n=1)
    return f" Did you mean {by_lower_case[matches[0]]!r}?" if matches else ""


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of cells as lines of columns of one width each."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
