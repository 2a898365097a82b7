"""The command line: `raytrace-jax render | fit | format | info`."""

from raytrace_jax.cli._main import main as main
