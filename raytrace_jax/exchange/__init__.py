"""Scenes for other renderers, and from them."""
