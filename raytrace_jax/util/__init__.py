"""Shared helpers: numerics, compilation, files, sessions, text."""
