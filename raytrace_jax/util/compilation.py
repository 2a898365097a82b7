"""One place for how programs are compiled: `jit` with the options that were measured to help on the CPU."""

import functools

import jax

CPU_OPTIONS = {
    # The older loop emitters compile in half the time and run this kind of code twice as fast.
    "xla_cpu_use_fusion_emitters": False,
    # Use the whole width of the vector units where there are 512 bits: a seventh faster.
    "xla_cpu_prefer_vector_width": 512,
    # See that the branches of a condition may share their operands' memory: a quarter fewer copies and less time.
    "xla_cpu_copy_insertion_use_region_analysis": True,
}


@functools.cache
def compiler_options() -> dict[str, bool | int]:
    """Options for the default backend; those that this version of XLA does not know are left out."""
    if jax.default_backend() != "cpu":
        return {}
    return {name: value for name, value in CPU_OPTIONS.items() if _is_known(name, value)}


def _is_known(name: str, value: bool | int) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options={name: value}).lower(jax.ShapeDtypeStruct((), "float32")).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def jit(function=None, **options):
    """`jax.jit` with `compiler_options`; for outermost functions only."""
    if function is None:
        return functools.partial(jit, **options)
    compiled = None

    @functools.wraps(function)
    def call(*args, **kwargs):
        nonlocal compiled
        if compiled is None:  # Not at import: asking for the backend starts JAX.
            compiled = jax.jit(function, compiler_options=compiler_options(), **options)
        return compiled(*args, **kwargs)

    return call
