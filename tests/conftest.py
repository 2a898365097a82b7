"""The whole suite runs under strict flags, in double precision, with shapes checked, on two CPU devices."""

import os

import hypothesis
import jax
import jaxtyping

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)  # Tiles are shared out over devices: test it, whatever the machine.
jax.config.update("jax_debug_nans", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
# Rank promotion stays allowed: a scalar a ray times a vector a ray, "rays" times "3 rays", is the package's convention.

# In the numerical core every annotation of a shape or a type is checked at run time. The modules at the edges answer
# bad input with errors of their own instead. This must come before the package is imported.
CORE = "_numerics scene optics rays film geometry intersection shading compaction wavefront plan render"
CORE += " inverse derivatives ray_tree"
jaxtyping.install_import_hook([f"raytrace_jax.{module}" for module in CORE.split()], "beartype.beartype")

# A compile takes longer than any deadline; examples differ from run to run at home, not where a failure blocks others.
hypothesis.settings.register_profile("home", deadline=None)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "home")


def pytest_configure(config):
    # Programs compiled by an earlier run, or by the other process of `-n 2`, are not compiled again.
    jax.config.update("jax_compilation_cache_dir", str(config.cache.mkdir("jax")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
