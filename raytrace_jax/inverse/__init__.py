"""From a picture back to the scene: residuals, least squares, and how sure the answer is."""

from collections.abc import Callable

write_report: Callable[..., None]
"""Writes a result's report into a folder. Reports lie above fits, so the package's front puts their writer here."""
