"""Errors of the command line itself."""


class UsageError(Exception):
    """Options that parse but make no sense, alone or together (exit code 2)."""
