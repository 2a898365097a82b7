"""The scene of a job."""

import functools

import jax.numpy as jnp
import numpy as np

from raytrace_jax.batch.jobs import Job
from raytrace_jax.batch.plan import Values
from raytrace_jax.scene.modelfile import parse_scene
from raytrace_jax.scene.parameters import set_parameters
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import ModelName


def job_scene(job: Job, values: Values | None = None) -> Scene:
    """A job's scene with its values, or with other ones; float64 needs `jax_enable_x64`.

    Raises:
        ParameterError: the values are impossible together.
    """
    dtype = np.dtype(jnp.float64 if job.precision == 64 else jnp.float32)
    return set_parameters(_parsed(job.scene, dtype, job.settings.model), job.values if values is None else values)


@functools.lru_cache(maxsize=64)
def _parsed(text: str, dtype: np.dtype, model: ModelName) -> Scene:
    """The scene of a text; the jobs of a batch share few of them."""
    return parse_scene(text, dtype=dtype, model=model)
