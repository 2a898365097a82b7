"""Rays level by level: what one level is, and down and up through all of them."""
