"""Loops as users write them, which start a program before the last one has ended: on one device and on two."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import user_loops

from raytrace_jax.tracer.plan import can_share_loops

HERE = Path(__file__).parent


def in_a_process(devices, threads):
    """What each loop ends at in a process with so many devices and so many threads for them."""
    # Where the suite keeps its compiled programs, so that the second run finds them.
    cache = {"JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir or "", "NPROC": str(threads)}
    command = [sys.executable, str(HERE / "user_loops.py"), str(devices)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | cache, check=False)
    assert done.returncode == 0, done.stderr
    rows = (line.split() for line in done.stdout.splitlines())
    return {name: [float.fromhex(number) for number in numbers] for name, *numbers in rows}


@pytest.fixture(scope="module")
def shared():
    """On two devices that share each picture."""
    return in_a_process(2, 4)


@pytest.mark.parametrize(("threads", "can"), [("1", False), ("3", False), ("4", True), ("64", True)])
def test_devices_share_pictures_of_loops_where_there_are_threads_for_it(threads, can, monkeypatch):
    monkeypatch.setenv("NPROC", threads)
    assert jax.device_count() == 2 and can_share_loops() is can
    assert user_loops.setup()[1].plan.for_loops().on_all_devices is can


@pytest.mark.parametrize("name", user_loops.LOOPS)
def test_a_loop_ends_at_the_same_numbers_whether_two_devices_share_its_pictures_or_not(name, shared, monkeypatch):
    monkeypatch.setenv("NPROC", "2")
    # Adam divides by the size of the gradient, which rounding is near the end.
    tolerance = 1e-3 if name == "optax_adam" else 1e-6
    with jax.numpy_dtype_promotion("standard"):  # optax relies on it.
        found = np.ravel(user_loops.LOOPS[name]())
    np.testing.assert_allclose(found, shared[name], rtol=tolerance)


@pytest.mark.parametrize(
    "name", ["steps_by_hand", "optax_adam", "optimistix_levenberg_marquardt", "optimistix_bfgs", "scan_over_steps"]
)
def test_a_loop_that_minimises_finds_the_parameter(name, shared):
    _, residual, _ = user_loops.setup()
    found = residual.parameters(jnp.array(shared[name]))["board.diffuse.r"]
    assert float(found) == pytest.approx(user_loops.TRUTH["board.diffuse.r"], abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("devices", "threads"), [(1, 1), (1, 2), (2, 2), (2, 8)])
def test_no_loop_locks_up_whatever_the_threads(devices, threads, shared):
    found = in_a_process(devices, threads)
    for name in user_loops.LOOPS:
        np.testing.assert_allclose(found[name], shared[name], rtol=1e-3 if name == "optax_adam" else 1e-6)
