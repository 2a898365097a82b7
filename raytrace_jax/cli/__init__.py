"""The command line: `raytrace-jax COMMAND`; `commands` has the table of them."""

from raytrace_jax.cli.dispatch import main as main
