"""Loops as users write them, on two devices (those of the whole suite) and on one."""

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


@pytest.fixture(scope="module")
def on_one_device():
    """What each loop ends at in a process with one device."""
    # Where the suite keeps its compiled programs, so that the second run finds them.
    cache = {"JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir or ""}
    command = [sys.executable, str(HERE / "user_loops.py"), "1"]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | cache, check=False)
    assert done.returncode == 0, done.stderr
    rows = (line.split() for line in done.stdout.splitlines())
    return {name: [float.fromhex(number) for number in numbers] for name, *numbers in rows}


@pytest.mark.parametrize("name", user_loops.LOOPS)
def test_a_loop_ends_at_the_same_numbers_on_two_devices_and_on_one(name, on_one_device):
    assert jax.device_count() == 2
    # Adam divides by the size of the gradient, which rounding is near the end.
    tolerance = 1e-3 if name == "optax_adam" else 1e-6
    with jax.numpy_dtype_promotion("standard"):  # optax relies on it.
        found = np.ravel(user_loops.LOOPS[name]())
    np.testing.assert_allclose(found, on_one_device[name], rtol=tolerance)


@pytest.mark.parametrize(
    "name", ["steps_by_hand", "optax_adam", "optimistix_levenberg_marquardt", "optimistix_bfgs", "scan_over_steps"]
)
def test_a_loop_that_minimises_finds_the_parameter(name, on_one_device):
    _, residual, _ = user_loops.setup()
    found = residual.parameters(jnp.array(on_one_device[name]))["board.diffuse.r"]
    assert float(found) == pytest.approx(user_loops.TRUTH["board.diffuse.r"], abs=1e-3)
