"""What is known of the parameters before a fit."""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.errors import ParameterError
from raytrace_jax.inverse.problem.unknowns import Unknowns

Priors = Mapping[str, tuple[float, float]]
"""Mean and standard deviation by name of a free scalar parameter."""


class Prior(eqx.Module):
    """Independent Gaussian priors on the values of the free parameters.

    Args:
        mean: of each parameter.
        precision: one over the standard deviation; 0 where there is no prior.
    """

    mean: Float[Array, " parameters"]
    precision: Float[Array, " parameters"]


def make_prior(priors: Priors, unknowns: Unknowns, dtype: jnp.dtype) -> Prior:
    """The priors, by names of `unknowns`, as arrays.

    Raises:
        ParameterError: a mean or standard deviation that makes no sense.
    """
    mean, precision = np.zeros((2, len(unknowns.names)))
    for name, (middle, deviation) in priors.items():
        if not np.isfinite(middle) or not (np.isfinite(deviation) and deviation > 0):
            raise ParameterError(
                f"prior on {name}: {middle:g}+-{deviation:g}; wanted a finite mean and a standard deviation above 0."
            )
        place = unknowns.names.index(name)
        mean[place], precision[place] = middle, 1 / deviation
    return Prior(jnp.asarray(mean, dtype), jnp.asarray(precision, dtype))
