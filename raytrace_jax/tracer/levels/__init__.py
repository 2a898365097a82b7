"""Rays level by level, down and up through all of them."""
