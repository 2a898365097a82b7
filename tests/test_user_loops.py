"""Loops as users write them, which start a program before the last one has ended: on one device and on two."""

import functools
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import user_loops

HERE = Path(__file__).parent


def in_a_process(devices, names):
    """What each loop ends at in a process with so many devices."""
    # With XLA's effort as here, and where the suite keeps its compiled programs, so that the second run finds them.
    variables = {
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir or "",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
    }
    command = [sys.executable, str(HERE / "user_loops.py"), str(devices), *names]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | variables, check=False)
    assert done.returncode == 0, done.stderr
    rows = (line.split() for line in done.stdout.splitlines())
    return {name: [float.fromhex(number) for number in numbers] for name, *numbers in rows}


@functools.cache
def here(name):
    """What a loop ends at in this process."""
    with jax.numpy_dtype_promotion("standard"):  # optax relies on it.
        return np.ravel(user_loops.LOOPS[name]())


def assert_same(name, found, wanted):
    # Adam divides by the size of the gradient, which rounding is near the end.
    np.testing.assert_allclose(found, wanted, rtol=1e-3 if name == "optax_adam" else 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["steps_by_hand", "optax_adam", "optimistix_levenberg_marquardt", "optimistix_bfgs", "scan_over_steps"]
)
def test_a_loop_that_minimises_finds_the_parameter(name):
    _, residual, _ = user_loops.setup()
    found = residual.parameters(jnp.array(here(name)))["board.diffuse.r"]
    assert float(found) == pytest.approx(user_loops.TRUTH["board.diffuse.r"], abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("devices", [1, 2])
def test_loops_end_at_the_same_numbers_with_one_device_and_with_two(devices):
    found = in_a_process(devices, user_loops.LOOPS)
    assert found.keys() == user_loops.LOOPS.keys()
    for name, numbers in found.items():
        assert_same(name, numbers, here(name))
