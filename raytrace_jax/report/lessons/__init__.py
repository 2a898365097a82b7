"""Lessons: figures for teaching, made by the library itself, with the page that shows and explains them."""
