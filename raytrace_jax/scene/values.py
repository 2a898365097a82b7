"""Values that come from Python: arrays of a shape and a dtype, checked as far as they are known already."""

import warnings
from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Array

from raytrace_jax.errors import SceneWarning
from raytrace_jax.util.numerics import cast
from raytrace_jax.util.text import quoted

Value = ArrayLike | Iterable[ArrayLike]


def is_traced(value: object) -> bool:
    """Whether a value, or anything in it, is only known when a program runs: it cannot be checked yet."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))


def as_array(value: Value, shape: tuple[int, ...], dtype: np.dtype) -> Array | np.ndarray:
    """An array of numbers, a NumPy array unless something in the value is traced; a single number may come in a row.

    Raises:
        ValueError: no numbers, another shape, or not finite; the message is what follows the value's name.
    """
    try:
        array = jnp.asarray(value, dtype) if is_traced(value) else cast(np.asarray(value, np.float64), dtype)
    except (TypeError, ValueError):
        raise ValueError(f"takes a number or a row of numbers, got {quoted(str(value))}") from None
    if array.shape == (1,) and shape == ():
        array = array.reshape(())
    if array.shape != shape:
        wanted, got = counted(shape[0] if shape else 1), f"an array of shape {array.shape}"
        got = counted(array.size) if array.ndim < 2 else got
        raise ValueError(f"takes {wanted}, got {got}")
    if not is_traced(array) and not np.all(np.isfinite(array)):
        raise ValueError(f"must be finite in {dtype}, got {quoted(str(value))}")
    return array


def counted(numbers: int) -> str:
    """`1 number`, `3 numbers`."""
    return f"{numbers} number{'s' if numbers != 1 else ''}"


def floating(dtype: DTypeLike | None) -> np.dtype:
    """The dtype that JAX makes of one, or of None.

    Raises:
        TypeError: it is not a floating type.

    Warns:
        SceneWarning: float64 is asked for while JAX computes without it.
    """
    float_dtype = jax.dtypes.canonicalize_dtype(float if dtype is None else dtype)
    if not jnp.issubdtype(float_dtype, jnp.floating):
        raise TypeError(f"dtype must be a floating type, got {float_dtype}")
    # Python's `float` is whichever JAX computes in.
    if dtype is not None and dtype is not float and np.dtype(dtype) != float_dtype:
        warnings.warn(
            f"the scene is in {float_dtype}: {np.dtype(dtype)} needs jax.config.update('jax_enable_x64', True) before.",
            SceneWarning,
            stacklevel=4,
        )
    return float_dtype
