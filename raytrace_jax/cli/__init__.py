"""The command line: `raytrace-jax COMMAND`; `commands` has the table of them."""

from raytrace_jax.cli._main import main as main
