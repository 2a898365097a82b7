"""One place for how programs are compiled: `jit` with the options that were measured to help on the CPU."""

import functools

import jax

CPU_OPTIONS = {
    # The older loop emitters compile in half the time and run this kind of code twice as fast.
    "xla_cpu_use_fusion_emitters": False,
    # Use the whole width of the vector units where there are 512 bits: a seventh faster.
    "xla_cpu_prefer_vector_width": 512,
}


def jit(function=None, **options):
    """`jax.jit` with compiler options chosen for the backend; for outermost functions only."""
    if function is None:
        return functools.partial(jit, **options)
    compiled = None

    @functools.wraps(function)
    def call(*args, **kwargs):
        nonlocal compiled
        if compiled is None:  # Not at import: asking for the backend starts JAX.
            compiler_options = CPU_OPTIONS if jax.default_backend() == "cpu" else {}
            compiled = jax.jit(function, compiler_options=compiler_options, **options)
        return compiled(*args, **kwargs)

    return call
