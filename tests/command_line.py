"""The command line within the process of the tests."""

from raytrace_jax.cli import main


def run(*arguments):
    """The exit code of `raytrace-jax` with these arguments, each of which is written as text."""
    return main([str(argument) for argument in arguments])
