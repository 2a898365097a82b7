"""Dataclasses whose annotations say what each option can be: one check serves Python, command line and plans."""

import ast
import dataclasses
import functools
import inspect
import itertools
import math
import textwrap
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import ParameterError, RaytraceError
from .text import did_you_mean

T = TypeVar("T")


class Wanted(NamedTuple):
    """Limits of an option's number, or of each number in a row: a part of its annotation."""

    words: str = ""  # What is wanted; without them it is said by type and limits.
    metavar: str | None = None  # Stands for the value in help.
    least: float = -math.inf
    most: float = math.inf
    above: float | None = None  # The number may not reach this, nor `below`.
    below: float | None = None
    nonempty: bool = False  # Whether a row has one entry at least.

    def holds(self, number: Any) -> bool:
        """Whether a number is within the limits; NaN is not, nor is an integer beyond all floats."""
        try:
            number = float(number)
        except (OverflowError, TypeError, ValueError):
            return False
        is_above = self.above is None or number > self.above
        return self.least <= number <= self.most and is_above and (self.below is None or number < self.below)


class Checked:
    """A dataclass that refuses what its annotations do not allow; the rows of its tuples may be given as any rows.

    Raises:
        RaytraceError: of the class `refused`: it begins with the option's name, and says what came and what is wanted.
    """

    refused: ClassVar[type[RaytraceError]] = ParameterError

    def __post_init__(self):
        for name, hint in hints(type(self)).items():
            value = getattr(self, name)
            if not suits(value, hint):
                texts = value if isinstance(value, list | tuple) else (value,)
                unknown = next((text for text in texts if isinstance(text, str) and text not in words_of(hint)), "")
                close = did_you_mean(unknown, map(str, words_of(hint)))
                raise self.refused(f"{name} is {value!r}; wanted {in_words(hint)}.{close}")
            if is_row(hint) and value is not None:
                kind = core(get_args(core(hint))[0])
                object.__setattr__(self, name, tuple(map(kind, value)) if kind in (int, float) else tuple(value))


@functools.cache
def field_texts(options: type) -> dict[str, str]:
    """The texts below a class' own fields by name, each on one line; to find them Python parses the whole module."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(options))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for entry, below in itertools.pairwise(definition.body):
        match entry, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                found[name] = " ".join(text.split())
    return found


class OptionList:
    """A class' docstring that lists the options, each with its type and its text, as soon as it is asked for."""

    def __init__(self, words: str):
        self.words = inspect.cleandoc(words)

    def __get__(self, instance: object, owner: type) -> str:
        texts = {name: text for base in reversed(owner.__mro__[:-1]) for name, text in field_texts(base).items()}
        wrap = textwrap.TextWrapper(100, initial_indent=" " * 4, subsequent_indent=" " * 8)
        rows = (
            wrap.fill(f"{name}: {in_words(hint)}{', or None' * suits(None, hint)}. {texts.get(name, '')}")
            for name, hint in hints(owner).items()
        )
        words, raises, errors = self.words.partition("Raises:\n")
        return "\n".join([words, "Args:", *rows, "", raises + errors]).rstrip()


def listed_in_help(options: type[T]) -> type[T]:
    """Let `help` of a dataclass of options say its types in words, once; use it as a decorator."""
    options.__doc__ = OptionList(options.__doc__ or "")  # pyright: ignore[reportAttributeAccessIssue]
    options.__init__.__annotations__ = {}
    return options


def refuse_other(given: object, wanted: type, maker: str = "") -> None:
    """Raise RaytraceError for what is not of the type that is wanted, which `maker` returns.

    `Checked` options need no maker: the error, of the class that they refuse with, says how they are written.
    """
    if isinstance(given, wanted):
        return
    if issubclass(wanted, Checked):
        written = ", ".join(f"{name}={value!r}" for name, value in given.items()) if isinstance(given, dict) else "..."
        name = wanted.__name__
        raise wanted.refused(f"{name} are wanted, and this is {given!r}: write {name}({written}).")
    came = f"of the type {type(given).__name__}"
    raise RaytraceError(f"a {wanted.__name__} is wanted, as {maker} returns it, and this is {came}.")


@functools.cache
def hints(options: type) -> dict[str, Any]:
    """The annotations of the fields of a class of options, by name, with what `Annotated` says."""
    found = get_type_hints(options, include_extras=True)
    return {field.name: found[field.name] for field in dataclasses.fields(options)}


def wanted(hint: Any) -> Wanted:
    """What an annotation says is wanted of a value."""
    found = [part for part in getattr(hint, "__metadata__", ()) if isinstance(part, Wanted)]
    return found[0] if found else Wanted()


def core(hint: Any) -> Any:
    """The type in an annotation, without what is said beside it and without None."""
    if get_origin(hint) is Annotated:
        return core(get_args(hint)[0])
    others = [kind for kind in get_args(hint) if kind is not NoneType]
    return core(others[0]) if get_origin(hint) in (Union, UnionType) and len(others) == 1 else hint


def is_row(hint: Any) -> bool:
    """Whether an annotation is that of several values, a tuple or a sequence."""
    return get_origin(core(hint)) in (tuple, Sequence)


def suits(value: Any, hint: Any, limits: Wanted | None = None) -> bool:
    """Whether a value is of the annotated type and within its limits."""
    kinds, origin = get_args(hint), get_origin(hint)
    if origin is Annotated:
        return suits(value, kinds[0], wanted(hint))
    if origin in (Union, UnionType):
        return any(suits(value, kind, limits) for kind in kinds)
    if origin is Literal:
        return any(type(value) is type(word) and value == word for word in kinds)
    if hint in (int, float):
        # A number of NumPy or JAX is one, too.
        is_one = isinstance(value, Integral if hint is int else Real) and not isinstance(value, bool)
        is_one = is_one or (hint is float and getattr(value, "shape", None) == ())
        return is_one and (limits or Wanted()).holds(value)
    if origin is Mapping:
        return isinstance(value, Mapping) and all(suits(k, kinds[0]) and suits(v, kinds[1]) for k, v in value.items())
    if origin in (tuple, Sequence):
        is_row = isinstance(value, Sequence) and not isinstance(value, str | bytes)
        if not is_row and len(getattr(value, "shape", ())) != 1:
            return False
        if limits and limits.nonempty and not len(value):
            return False
        each = kinds[:1] * len(value) if origin is Sequence or kinds[-1] is ... else kinds
        return len(each) == len(value) and all(suits(v, kind, limits) for v, kind in zip(value, each, strict=True))
    return isinstance(value, hint)


def in_words(hint: Any) -> str:
    """What an annotation wants, in words: `a number from 0 to 1`."""
    said, kind, words = wanted(hint), core(hint), words_of(hint)
    if said.words:
        return said.words
    if words:
        return ("names among " if is_row(hint) else "one of ") + ", ".join(map(str, words))
    most = said.most if said.below is None else f"less than {said.below}"
    limits = f", {said.least} or more" if most == math.inf else f" from {said.least} to {most}"
    limits = "" if said.least == -math.inf else limits
    return {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}[kind] + limits


def words_of(hint: Any) -> tuple[Any, ...]:
    """The words or numbers that an option, or an entry of its row, can be; none if that is open."""
    kind = core(hint)
    if get_origin(kind) is Literal:
        return get_args(kind)
    return words_of(get_args(kind)[0]) if get_origin(kind) is tuple else ()
