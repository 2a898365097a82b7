"""A page on this machine that shows a scene while its numbers are moved."""
