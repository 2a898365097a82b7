"""Shading models: what a surface shows of its own, which rays it sends on, and how their colours come back."""
